// Connection: the WebSocket to the bridge. It reconnects by itself, and every request is answered or fails.
import { unpack } from "./messages.js";

const FIRST_WAIT_MS = 300;
const LONGEST_WAIT_MS = 5000;
const PING_MS = 2000;
const SILENT_MS = 20_000; // without any message after a request: the network is gone, which no event reports
const FINAL = new Set([4400, 4401]); // the room cannot be had, the token is wrong: retrying would not help

export class Connection extends EventTarget {
  /**
   * Events: "message" (detail: the JSON), "binary" (detail: {header, rows}), "line" (detail: open, lost or refused).
   * refusal: once refused, the bridge's reason.
   */
  constructor(room, token) {
    super();
    this.roundTripMs = null;
    this.refusal = "";
    this._address = new URL(`ws?room=${encodeURIComponent(room)}&token=${encodeURIComponent(token)}`, location.href);
    this._address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    this._address.hash = "";
    this._waiting = new Map();
    this._next = 1;
    this._waitMs = FIRST_WAIT_MS;
    this._askedMs = null; // since when a request has been followed by no message
    this._connect();
    setInterval(() => this._ping(), PING_MS);
  }

  get isOpen() {
    return this._socket.readyState === WebSocket.OPEN;
  }

  /** Send a request; resolves with its answer, rejects with an Error that says why. */
  ask(message) {
    if (!this.isOpen) return Promise.reject(new Error(this.refusal || "the connection to the bridge is lost; trying again"));
    const request = this._next++;
    this._socket.send(JSON.stringify({ ...message, request }));
    return new Promise((resolve, reject) => this._waiting.set(request, { resolve, reject }));
  }

  _connect() {
    const socket = (this._socket = new WebSocket(this._address));
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this._waitMs = FIRST_WAIT_MS;
      this._tell("line", "open");
    };
    socket.onmessage = (event) => this._hear(event.data);
    socket.onclose = (event) => this._lose(event);
  }

  /** Give up a connection on which nothing comes. The browser would notice its end only after minutes. */
  _drop() {
    this._socket.onmessage = this._socket.onclose = null;
    this._socket.close();
    this._lose({ code: 1006, reason: "" });
  }

  _hear(data) {
    this._askedMs = null;
    if (typeof data !== "string") {
      this._tell("binary", unpack(data));
      return;
    }
    const message = JSON.parse(data);
    if (message.type !== "answer") {
      this._tell("message", message);
      return;
    }
    const asked = this._waiting.get(message.request);
    this._waiting.delete(message.request);
    if (message.error) asked?.reject(new Error(message.error));
    else asked?.resolve(message);
  }

  _lose(event) {
    for (const { reject } of this._waiting.values()) reject(new Error("the connection to the bridge was lost"));
    this._waiting.clear();
    this.roundTripMs = this._askedMs = null;
    if (FINAL.has(event.code)) {
      this.refusal = event.reason || "the bridge refuses this page";
      this._tell("line", "refused");
      return;
    }
    this._tell("line", "lost");
    setTimeout(() => this._connect(), this._waitMs);
    this._waitMs = Math.min(this._waitMs * 1.6, LONGEST_WAIT_MS);
  }

  async _ping() {
    if (!this.isOpen) return;
    const at = performance.now();
    if (this._askedMs !== null && at - this._askedMs > SILENT_MS) {
      this._drop();
      return;
    }
    this._askedMs ??= at;
    try {
      await this.ask({ op: "ping", at });
      this.roundTripMs = performance.now() - at;
    } catch {
      this.roundTripMs = null; // the connection was lost, which is reported elsewhere
    }
  }

  _tell(name, detail) {
    this.dispatchEvent(new CustomEvent(name, { detail }));
  }
}
