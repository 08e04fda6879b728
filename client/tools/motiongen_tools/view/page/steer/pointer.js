// The pointer on the stage: tells clicks from drags; the tools define what these do.

const CLICK_PX = 5;

export class Pointer {
  /**
   * tool: a function that gives the tool of now: {click(event), down(event) -> whether it takes the drag, move, up}.
   * onCancel: is called where a drag will have no end.
   */
  constructor(stage, tool, onCancel) {
    this._stage = stage;
    this._tool = tool;
    this._onCancel = onCancel;
    this._from = null;
    this._isTaken = false;
    const canvas = stage.canvas;
    canvas.addEventListener("pointerdown", (event) => this._down(event), { capture: true });
    canvas.addEventListener("pointermove", (event) => this._move(event), { capture: true });
    canvas.addEventListener("pointerup", (event) => this._up(event), { capture: true });
    canvas.addEventListener("pointercancel", () => {
      this._drop();
      this._onCancel();
    });
  }

  _down(event) {
    if (event.button !== 0) return;
    this._from = [event.clientX, event.clientY];
    this._isTaken = Boolean(this._tool().down?.(event));
    if (this._isTaken) {
      this._stage.controls.enabled = false;
      this._stage.canvas.setPointerCapture(event.pointerId);
    }
  }

  _move(event) {
    if (this._isTaken) this._tool().move?.(event);
    else this._tool().hover?.(event);
  }

  _up(event) {
    const from = this._from;
    const wasTaken = this._isTaken;
    this._drop();
    if (wasTaken) this._tool().up?.(event);
    else if (from && event.button === 0 && Math.hypot(event.clientX - from[0], event.clientY - from[1]) < CLICK_PX) {
      this._tool().click?.(event);
    }
  }

  _drop() {
    this._from = null;
    this._isTaken = false;
    this._stage.controls.enabled = true;
  }
}
