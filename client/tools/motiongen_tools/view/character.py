"""Character: one session as the page sees it: its frames, its edits, its script, and where it was late."""

from __future__ import annotations

import contextlib
import logging
from collections import deque
from typing import Any

import numpy as np

from motiongen_client.errors import InvalidInput, MotiongenError
from motiongen_client.motion import Float32
from motiongen_client.session import Session
from motiongen_client.types import ConstraintReached, Model, Reopened, ServiceLevel, SessionOptions
from motiongen_tools.view.commands import CUT_FRAMES, apply
from motiongen_tools.view.edit_log import EditLog, Entry, named
from motiongen_tools.view.feed import Feed
from motiongen_tools.view.fields import Message
from motiongen_tools.view.rehearsal import Rehearsal
from motiongen_tools.view.script import Script
from motiongen_tools.view.served_with import ServedWith
from motiongen_tools.view.wire import Head

MOST_MARKS = 400
LEAST_SCALE, MOST_SCALE = 0.1, 2.0
CUTS = ("teleport", "cut_to")
BRIDGE_FAILED = "the bridge failed at it; its log says why"

_log = logging.getLogger(__name__)


class Character:
    """number: its name on the wire; opening: the message that asked for it; rehearsal: what it is to be told again.

    revision rises with everything that the page shows of it beside frames.
    """

    def __init__(
        self,
        number: int,
        name: str,
        session: Session,
        *,
        options: SessionOptions,
        model: Model,
        opening: Message,
        rehearsal: Rehearsal | None = None,
    ) -> None:
        self.number = number
        self.name = name
        self.session = session
        self.options = options
        self.opening = opening
        self.script = Script()
        self._served_with = ServedWith(options, session.opened, model)
        self.edits = EditLog()
        self.revision = 1
        self._end = ""  # why the session is over
        self._mishap = ""  # what went wrong beside it: the session lives on
        self._rehearsal = rehearsal
        self.time_scale = 1.0
        self._feed = Feed(session.playback)
        self._seams: deque[int] = deque(maxlen=MOST_MARKS)
        self._underruns: deque[int] = deque(maxlen=MOST_MARKS)
        self._num_underruns = 0
        self._plan = session.playback.plan
        session.on_constraint_reached = self._note_reached
        session.on_service_level = self._note_level
        session.on_reopened = self._note_reopened
        if opening.get("text") or opening.get("preset"):
            prompt = {"op": "set_prompt", "text": opening.get("text"), "preset": opening.get("preset")}
            self.script.take(prompt, session.playback.playhead, 1, (), 0)

    # ---- what it is told

    def tell(self, message: Message, *, can_be_undone: bool = True) -> Entry:
        """Do what a message says. Raises InvalidInput, or what ended the session."""
        if message.get("op") == "undo":
            return self._undo()
        is_option = message.get("op") == "set_options"
        if is_option:
            message = self._served_with.completed(message)
        edit = apply(self.session, message)
        if is_option:
            self._served_with.ask(message)
        entry = self.edits.add(
            message,
            named(message, edit.what),
            self.session.playback.playhead,
            edit,
            self._note_answer,
            can_be_undone=can_be_undone,
        )
        self.revision += 1
        return entry

    def _undo(self) -> Entry:
        last = self.edits.pop_undoable()
        if last is None:
            raise InvalidInput("op", "undo", "an edit of prompts, constraints or options, or a cut, before it")
        self.revision += 1
        return [self.tell(message, can_be_undone=False) for message in last.takes_back][-1]

    def rest(self, *, is_over: bool = False) -> None:
        """Pause while nobody looks, or go on once that is over. Raises what ended the session."""
        if is_over:
            self.session.resume()
        else:
            self.session.pause()
        self.revision += 1

    def set_time_scale(self, scale: float) -> None:
        """Raises InvalidInput."""
        if not LEAST_SCALE <= scale <= MOST_SCALE:
            raise InvalidInput("scale", scale, f"a number from {LEAST_SCALE} to {MOST_SCALE}")
        self.session.set_time_scale(scale)
        self.time_scale = scale
        self.revision += 1

    # ---- what is seen of it

    @property
    def failure(self) -> str:
        """Why it has ended, or does not do what it was to do; "" where all is well."""
        return self._end or self._mishap

    @property
    def has_ended(self) -> bool:
        """Whether its session is over, so that nothing can be told to it any more."""
        return bool(self._end)

    def tick(self) -> int | None:
        """Move to the present. Returns the first frame that is new or replaced since the last tick, if any.

        Whatever goes wrong is its own failure, not raised: one character must not end the others'.
        """
        try:
            return self._move()
        except Exception:
            if self._mishap != BRIDGE_FAILED:  # once: it may be the same at every tick
                _log.exception("character %d failed", self.number)
                self._mishap = BRIDGE_FAILED
                self.revision += 1
            return None

    def _move(self) -> int | None:
        try:
            self.session.poll()
        except MotiongenError as failure:
            if not self._end:
                self._end = str(failure)
                self.revision += 1
        self._rehearse()
        playback = self.session.playback
        changed = self._feed.changed_from()
        if changed is not None:
            self._look_at(changed)
        if playback.plan != self._plan and changed is not None:
            self._plan = playback.plan
            self._seams.append(playback.plan_from)
            self.revision += 1
        if playback.underruns != self._num_underruns:
            self._num_underruns = playback.underruns
            if not self._underruns or self._underruns[-1] != playback.playhead:
                self._underruns.append(playback.playhead)
            self.revision += 1
        if self.edits.look():
            self.revision += 1
        return changed

    def _look_at(self, first_frame: int) -> None:
        """Say it where frames that came have numbers that no picture can be made of."""
        playback = self.session.playback
        rows = playback.held_rows(first_frame, playback.buffered_to)
        broken = next((n for n, row in enumerate(rows) if not np.isfinite(row).all()), None)
        if broken is not None and not self._mishap:
            self._mishap = f"frame {first_frame + broken} came with a number that is not finite: it cannot be shown"
            self.revision += 1

    def head(self, now_s: float, sent_to: int) -> Head:
        """Where it stands, with the frames from sent_to on, less those that are past."""
        playback = self.session.playback
        first = max(sent_to, playback.first_kept, playback.playhead - 1)
        rows = playback.held_rows(first, playback.buffered_to) if first < playback.buffered_to else []
        share = playback.share(now_s) if playback.started and playback.playhead + 1 < playback.buffered_to else 0.0
        is_moving = playback.is_playing and playback.started and playback.playhead + 1 < playback.buffered_to
        pace = playback.frame_rate_hz * self.time_scale if is_moving else 0.0
        place = playback.playhead + share
        return Head(self.number, place, pace, playback.committed_to, playback.buffered_to, first, rows)

    def _rehearse(self) -> None:
        """Tell what is due of what another was told; after its last frame, rest."""
        if self._rehearsal is None or self.has_ended:
            return
        playhead = self.session.playback.playhead
        for then in self._rehearsal.due(playhead):
            try:
                told = self.tell(self._rehearsal.renumbered(then.message), can_be_undone=False)
                self._rehearsal.told(then, told.edit)
            except Exception as failure:
                why = str(failure)
                if not isinstance(failure, MotiongenError):
                    _log.exception("character %d failed at what was said at frame %d", self.number, then.at_frame)
                    why = BRIDGE_FAILED
                self._mishap = f"what was said at frame {then.at_frame} cannot be said again: {why}"
                self._rehearsal = None
                self.revision += 1
                return
        if playhead >= self._rehearsal.end_frame - 1:
            left, self._rehearsal = self._rehearsal.left, None
            if left:
                self._mishap = f"its last frame came before {len(left)} of its edits, which are not said again"
            with contextlib.suppress(MotiongenError):  # it has ended, which `poll` tells when its frames are over
                self.session.pause()
            self.revision += 1

    def history(self, first_frame: int, end_frame: int) -> tuple[int, list[Float32]]:
        """The frames shown so far within a range, as far as they are kept."""
        playback = self.session.playback
        first = max(first_frame, playback.first_kept)
        return first, playback.held_rows(first, max(min(end_frame, playback.playhead + 1), first))

    def shown(self) -> dict[str, Any]:
        """All but its frames, as the page shows it."""
        session, stats = self.session, self.session.stats
        return {
            "number": self.number,
            "name": self.name,
            "model": session.opened.model_id,
            "rig": session.opened.rig_id,
            "seed": str(session.opened.seed),
            "steps": session.opened.denoise_steps,
            "lookahead_frames": session.opened.lookahead_frames,
            "is_paused": session.is_paused,
            "is_rehearsing": self._rehearsal is not None,
            "time_scale": self.time_scale,
            "first_kept": session.playback.first_kept,
            "service_level": session.service_level.tier,
            "failure": self.failure,
            "latency_ms": self.edits.latency_ms,
            "underruns": stats.underruns,
            "late_plans": stats.late_plans,
            "reopenings": stats.reopenings,
            "resumes": stats.resumes,
            "seams": list(self._seams),
            "underrun_frames": list(self._underruns),
            "edits": self.edits.shown(),
            **self.script.shown(),
        }

    async def close(self) -> None:
        """End the session."""
        self.edits.close()
        if not self.has_ended:
            await self.session.close()

    # ---- what the server says

    def _note_answer(self, entry: Entry) -> None:
        is_accepted = entry.state == "accepted"
        if is_accepted:
            entry.takes_back = self._way_back(entry)
            playhead, edit = self.session.playback.playhead, entry.edit
            self.script.take(entry.message, entry.effective_frame, edit.prompt_id, edit.constraint_ids, playhead)
            self.script.note_placements(entry.placements)
        if entry.message.get("op") == "set_options":
            self._served_with.answer(entry.message, is_accepted)
        self.revision += 1

    def _way_back(self, entry: Entry) -> list[Message]:
        """What undoes an edit, by what held until now: others may have been on their way when it was said."""
        operation = entry.message.get("op")
        if operation == "set_options":
            back = self._served_with.inverse(entry.message)
            return [back] if len(back) > 1 else []  # it named none
        if operation in CUTS:  # back to where it was: on from the frames before the cut
            frame = entry.effective_frame or 0
            return [{"op": "cut_to", "frame": frame}] if frame >= CUT_FRAMES else []
        return self.script.inverse(entry.message, entry.edit.prompt_id, entry.edit.constraint_ids)

    def _note_reached(self, reached: ConstraintReached) -> None:
        self.script.note_reached(reached)
        self.revision += 1

    def _note_level(self, _: ServiceLevel) -> None:
        self.revision += 1

    def _note_reopened(self, told: Reopened) -> None:
        self.script.note_reopened(told.frame)
        self.revision += 1
