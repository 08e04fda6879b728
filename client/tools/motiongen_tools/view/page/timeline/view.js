// The visible part of the timeline: converts frames to pixels and back.

const BEHIND = 0.4; // fraction of the width behind the playhead

export class TimeView {
  constructor() {
    this.width = 1;
    this.frameRate = 20;
    this.seconds = 12;
    this.first = 0; // frame at the left edge
    this.isHeld = false; // scrolled by hand: it does not follow the playhead
  }

  get pixelsPerFrame() {
    return this.width / (this.seconds * this.frameRate);
  }

  follow(frame) {
    if (!this.isHeld) this.first = frame - BEHIND * this.seconds * this.frameRate;
  }

  toX(frame) {
    return (frame - this.first) * this.pixelsPerFrame;
  }

  toFrame(x) {
    return Math.round(this.first + x / this.pixelsPerFrame);
  }

  zoom(factor, x) {
    const under = this.first + x / this.pixelsPerFrame;
    this.seconds = Math.min(Math.max(this.seconds * factor, 2), 120);
    this.first = under - x / this.pixelsPerFrame;
  }

  scroll(frames) {
    this.isHeld = true;
    this.first = Math.max(this.first + frames, -this.frameRate);
  }
}
