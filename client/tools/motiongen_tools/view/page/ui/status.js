// The line at the top: server, characters, buffered frames, latency, frame rate.
import { make } from "./dom.js";

const PERIOD_MS = 250;

export class Status {
  constructor(element, cast, connection) {
    this._cast = cast;
    this._connection = connection;
    this._frames = 0;
    this._sinceMs = performance.now();
    this._line = "connecting";
    this.values = {};
    connection.addEventListener("line", (event) => (this._line = event.detail));
    const fields = {
      server: "server", characters: "characters", buffered: "buffered", latency: "latency",
      roundTrip: "round trip", underruns: "underruns", level: "service", rate: "drawn",
    };
    this._fields = {};
    element.append(make("strong", {}, "motiongen"));
    for (const [key, label] of Object.entries(fields)) {
      this._fields[key] = make("output", { id: `status-${key}` }, "–");
      element.append(make("span", { className: "field" }, make("span", { className: "name" }, label), this._fields[key]));
    }
  }

  /** Called for every frame drawn; returns the frames a second whenever there is a new value. */
  count(nowMs) {
    this._frames++;
    const spentMs = nowMs - this._sinceMs;
    if (spentMs < PERIOD_MS) return null;
    this._show(this._frames / (spentMs / 1000), nowMs);
    this._frames = 0;
    this._sinceMs = nowMs;
    return this.values.rateHz;
  }

  _show(rate, nowMs) {
    const { one, members, server } = this._cast;
    const values = {
      server: this._serverState(server),
      characters: String(members.size),
      rate: `${rate.toFixed(0)} Hz`,
      roundTrip: this._connection.roundTripMs === null ? "–" : `${this._connection.roundTripMs.toFixed(0)} ms`,
      buffered: "–", latency: "–", underruns: "–", level: "–",
    };
    if (one) {
      const ahead = Math.max(one.track.end - 1 - one.track.playhead(nowMs), 0);
      values.buffered = `${ahead.toFixed(0)} frames, ${(ahead / one.rig.frameRate).toFixed(1)} s`;
      values.latency = one.info.latency_ms === null ? "–" : `${one.info.latency_ms} ms`;
      values.underruns = String(one.info.underruns);
      values.level = one.info.service_level.replaceAll("_", " ");
    }
    this.values = { ...values, rateHz: rate };
    for (const [key, value] of Object.entries(values)) if (this._fields[key].value !== value) this._fields[key].value = value;
  }

  _serverState(server) {
    if (this._line === "refused") return this._connection.refusal;
    if (this._line !== "open") return "no connection to the bridge; trying again";
    if (server.state === "connected") return server.address;
    if (server.state === "lost") return `the connection to ${server.address} is lost; trying again`;
    return server.detail || `waiting for ${server.address}`;
  }
}
