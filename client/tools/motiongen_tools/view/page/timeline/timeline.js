// Timeline: played and planned frames and the edits of the chosen character; seek, pause, pace, undo.
import { labelled, make, trying } from "../ui/dom.js";
import { drawTimeline, endOf, ROWS } from "./drawing.js";
import { TimeView } from "./view.js";

const EDGE_PX = 7;

export class Timeline {
  /** seek: the frame looked at while looking back, otherwise null. */
  constructor(element, cast) {
    this._cast = cast;
    this._view = new TimeView();
    this.seek = null;
    this._plays = 0; // frames a second while looking back
    this._drag = null;
    this._sent = null; // a drag that has ended and has no answer yet
    this._loop = null;
    this._canvas = make("canvas", { id: "timeline-canvas", tabIndex: 0 });
    this._canvas.setAttribute("aria-label", "Timeline. Left and right look back and forward, Home goes live.");
    this._pause = make("button", { id: "pause", onclick: () => this.togglePause() }, "Pause");
    this._live = make("button", { id: "live", onclick: () => this.goLive() }, "Live");
    this._play = make("button", { id: "play-back", onclick: () => this._togglePlay() }, "Play from here");
    this._isLoop = make("input", { type: "checkbox", id: "loop" });
    this._scale = make("select", { id: "time-scale", onchange: () => this._setScale() });
    for (const scale of [0.25, 0.5, 1, 1.5, 2]) this._scale.append(make("option", { value: scale, selected: scale === 1 }, `× ${scale}`));
    this._undo = make("button", { id: "undo", onclick: () => this.undo() }, "Undo");
    this._where = make("output", { id: "where" });
    const steering = make("span", { className: "row steering" }, this._pause, labelled("pace", this._scale), this._undo);
    element.append(make("div", { className: "row" }, steering, this._live, this._play, make("label", { className: "inline" }, this._isLoop, "loop"), this._where), this._canvas);
    this._listen();
  }

  /** The frame of a member to show: the one looked at, or its playhead. */
  place(member, nowMs) {
    if (this.seek === null) return member.track.playhead(nowMs);
    return Math.min(Math.max(this.seek, member.track.first), member.track.end - 1);
  }

  goLive() {
    this.seek = null;
    this._plays = 0;
    this._view.isHeld = false;
  }

  togglePause() {
    const member = this._cast.one;
    if (member) trying(() => this._cast.tell({ op: member.info.is_paused ? "resume" : "pause" }));
  }

  undo() {
    trying(() => this._cast.tell({ op: "undo" }));
  }

  /** Look at a frame that was played. Requests it if this page does not have it. */
  lookAt(frame) {
    const member = this._cast.one;
    if (!member) return;
    const most = Math.floor(member.track.playhead());
    this.seek = Math.min(Math.max(frame, member.info.first_kept), most);
    if (this.seek >= member.track.first || member.isAsking) return;
    member.isAsking = true; // once for all frames: a moving pointer would ask again and again
    trying(() => this._cast.askHistory(member, member.info.first_kept, member.track.first)).finally(() => (member.isAsking = false));
  }

  /** Called for every frame drawn. */
  draw(nowMs) {
    const member = this._cast.one;
    const spentS = Math.min((nowMs - (this._drawnMs ?? nowMs)) / 1000, 0.2);
    this._drawnMs = nowMs;
    if (!member) return;
    const live = member.track.playhead(nowMs);
    if (this.seek !== null && this._plays) {
      this.seek += this._plays * spentS;
      if (this.seek >= live - 1) this.seek = this._isLoop.checked ? (this._loop ?? member.track.first) : live - 1;
    }
    this._view.frameRate = member.rig.frameRate;
    this._view.follow(live);
    this._resize();
    const colours = this._colours();
    drawTimeline(this._context, this._view, member, { colours, place: live, seek: this.seek, drag: this._drag ?? this._sent });
    this._say(member, live);
  }

  _say(member, live) {
    const looks = this.seek === null ? "live" : `looking at frame ${Math.round(this.seek)}`;
    const text = `${looks} · playhead ${Math.floor(live)} · committed to ${member.track.committedTo} · planned to ${member.track.end}`;
    if (this._where.value !== text) this._where.value = text;
    this._pause.textContent = member.info.is_paused ? "Go on" : "Pause";
    this._live.disabled = this.seek === null;
    this._play.textContent = this._plays ? "Stop" : "Play from here";
    if (document.activeElement !== this._scale) this._scale.value = String(member.info.time_scale);
  }

  _togglePlay() {
    const member = this._cast.one;
    if (!member) return;
    if (this.seek === null) this.lookAt(Math.floor(member.track.playhead()) - 5 * member.rig.frameRate);
    this._plays = this._plays ? 0 : member.rig.frameRate;
    this._loop = this._plays ? this.seek : null;
  }

  _setScale() {
    trying(() => this._cast.tell({ op: "time_scale", scale: Number(this._scale.value) }));
  }

  _listen() {
    const canvas = this._canvas;
    canvas.addEventListener("pointerdown", (event) => this._down(event));
    canvas.addEventListener("pointermove", (event) => this._move(event));
    canvas.addEventListener("pointerup", () => this._up());
    canvas.addEventListener("pointercancel", () => {
      this._isSeeking = false;
      this._drag = null;
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) this._view.scroll((event.deltaX || event.deltaY) / 8);
      else this._view.zoom(event.deltaY > 0 ? 1.15 : 1 / 1.15, event.offsetX);
    });
    canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowRight: 1, PageUp: -20, PageDown: 20 }[event.key];
      if (event.key === "Home") this.goLive();
      else if (step && this._cast.one) this.lookAt(Math.round(this.seek ?? this._cast.one.track.playhead()) + step);
      else return;
      event.preventDefault();
      event.stopPropagation();
    });
  }

  _down(event) {
    if (event.button !== 0) return; // a menu opens, and the button's release is not reported
    this._canvas.setPointerCapture(event.pointerId);
    const frame = this._view.toFrame(event.offsetX);
    const span = this._spanAt(event.offsetX, event.offsetY);
    if (span && this._cast.role === "control") {
      const nearEnd = span.end !== null && Math.abs(this._view.toX(span.end) - event.offsetX) < EDGE_PX;
      const nearStart = Math.abs(this._view.toX(span.start) - event.offsetX) < EDGE_PX;
      const part = nearEnd ? "end" : nearStart ? "start" : "whole";
      this._drag = { prompt_id: span.prompt_id, from: span.start, start: span.start, end: span.end, part, grabbed: frame, span };
      return;
    }
    this._isSeeking = true;
    this._plays = 0;
    this.lookAt(frame);
  }

  _move(event) {
    if (this._isSeeking) this.lookAt(this._view.toFrame(event.offsetX));
    const drag = this._drag;
    if (!drag) return;
    const moved = this._view.toFrame(event.offsetX) - drag.grabbed;
    const { start, end } = drag.span;
    if (drag.part !== "end") drag.start = Math.min(start + moved, drag.part === "start" && end !== null ? end - 1 : Infinity);
    if (drag.part !== "start" && end !== null) drag.end = Math.max(end + moved, drag.start + 1);
  }

  async _up() {
    this._isSeeking = false;
    const drag = (this._sent = this._drag);
    this._drag = null;
    if (!drag) return;
    const { span } = drag;
    if (drag.start !== span.start || drag.end !== span.end) {
      const message = { op: "set_prompt", prompt_id: span.prompt_id, frame: Math.max(drag.start, 0) };
      if (span.preset) message.preset = span.preset;
      else message.text = span.text;
      if (drag.end !== null) message.end_frame = drag.end;
      await trying(() => this._cast.tell(message));
    }
    if (this._sent === drag) this._sent = null;
  }

  /** The scheduled span under a point; spans that began with an edit cannot be moved. */
  _spanAt(x, y) {
    const member = this._cast.one;
    if (!member || y < ROWS.spans[0] || y > ROWS.spans[1]) return null;
    const { spans } = member.info;
    const horizon = Math.max(member.track.end, this._view.toFrame(this._view.width));
    return spans.findLast((span) => span.scheduled && x >= this._view.toX(span.start) - EDGE_PX &&
      x <= this._view.toX(endOf(span, spans, horizon)) + EDGE_PX) ?? null;
  }

  _resize() {
    const { clientWidth } = this._canvas;
    const width = Math.round(clientWidth * devicePixelRatio), height = Math.round(ROWS.marks[1] * devicePixelRatio);
    this._view.width = clientWidth;
    if (this._canvas.width === width && this._canvas.height === height) return;
    Object.assign(this._canvas, { width, height });
    this._context = this._canvas.getContext("2d");
    this._context.scale(devicePixelRatio, devicePixelRatio);
    this._palette = null;
  }

  _colours() {
    const isLight = document.documentElement.classList.contains("light");
    if (this._palette?.isLight !== isLight) {
      const style = getComputedStyle(document.documentElement);
      const of = (name) => style.getPropertyValue(`--${name}`).trim();
      this._palette = {
        isLight, text: of("text"), soft: of("soft"), grid: of("line"), accent: of("accent"), good: of("good"), bad: of("bad"),
        committed: isLight ? "#5b8bb5" : "#4c7fae", planned: isLight ? "#b9d2e8" : "#2c4a66",
      };
    }
    return this._palette;
  }
}
