"""Character: one session as the page shows it: its frames, edits, script, and when it was late."""

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
BRIDGE_FAILED = "the bridge failed; its log says why"

_log = logging.getLogger(__name__)


class Character:
    """One session. number: its name on the wire; opening: the message that asked for it; rehearsal: edits to repeat.

    revision rises with every change of what the page shows of it, except frames.
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
        self._mishap = ""  # what else went wrong; the session continues
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

    # ---- commands

    def tell(self, message: Message, *, can_be_undone: bool = True) -> Entry:
        """Apply a message. Raises InvalidInput, or what ended the session."""
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
        """Pause while nobody is watching, or resume if is_over. Raises what ended the session."""
        if is_over:
            self.session.resume()
        else:
            self.session.pause()
        self.revision += 1

    def set_time_scale(self, scale: float) -> None:
        """Play faster or slower. Raises InvalidInput."""
        if not LEAST_SCALE <= scale <= MOST_SCALE:
            raise InvalidInput("scale", scale, f"a number from {LEAST_SCALE} to {MOST_SCALE}")
        self.session.set_time_scale(scale)
        self.time_scale = scale
        self.revision += 1

    # ---- state

    @property
    def failure(self) -> str:
        """Why the session has ended, or what went wrong in it; "" if all is well."""
        return self._end or self._mishap

    @property
    def has_ended(self) -> bool:
        """Whether its session has ended, so that no message can be applied any more."""
        return bool(self._end)

    def tick(self) -> int | None:
        """Move to the present. Returns the first frame that is new or replaced since the last tick, if any.

        Errors are stored in `failure`, not raised, so that one character does not end the others.
        """
        try:
            return self._move()
        except Exception:
            if self._mishap != BRIDGE_FAILED:  # logged once: it may fail in the same way at every tick
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
        """Report frames with numbers that are not finite, which cannot be drawn."""
        playback = self.session.playback
        rows = playback.held_rows(first_frame, playback.buffered_to)
        broken = next((n for n, row in enumerate(rows) if not np.isfinite(row).all()), None)
        if broken is not None and not self._mishap:
            self._mishap = f"frame {first_frame + broken} has a number that is not finite: it cannot be shown"
            self.revision += 1

    def head(self, now_s: float, sent_to: int) -> Head:
        """The playhead, and the frames from sent_to on that have not been played yet."""
        playback = self.session.playback
        first = max(sent_to, playback.first_kept, playback.playhead - 1)
        rows = playback.held_rows(first, playback.buffered_to) if first < playback.buffered_to else []
        share = playback.share(now_s) if playback.started and playback.playhead + 1 < playback.buffered_to else 0.0
        is_moving = playback.is_playing and playback.started and playback.playhead + 1 < playback.buffered_to
        pace = playback.frame_rate_hz * self.time_scale if is_moving else 0.0
        place = playback.playhead + share
        return Head(self.number, place, pace, playback.committed_to, playback.buffered_to, first, rows)

    def _rehearse(self) -> None:
        """Repeat the edits of the rehearsal that are due; after its last frame, pause."""
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
                    _log.exception("character %d failed to repeat the edit at frame %d", self.number, then.at_frame)
                    why = BRIDGE_FAILED
                self._mishap = f"the edit at frame {then.at_frame} cannot be repeated: {why}"
                self._rehearsal = None
                self.revision += 1
                return
        if playhead >= self._rehearsal.end_frame - 1:
            left, self._rehearsal = self._rehearsal.left, None
            if left:
                self._mishap = f"its last frame came before {len(left)} of its edits, which are not repeated"
            with contextlib.suppress(MotiongenError):  # it has ended; `poll` raises that when its frames are over
                self.session.pause()
            self.revision += 1

    def history(self, first_frame: int, end_frame: int) -> tuple[int, list[Float32]]:
        """The frames played so far within a range, as far as they are kept."""
        playback = self.session.playback
        first = max(first_frame, playback.first_kept)
        return first, playback.held_rows(first, max(min(end_frame, playback.playhead + 1), first))

    def shown(self) -> dict[str, Any]:
        """Everything about it that the page shows, except frames."""
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

    # ---- reports of the server

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
        """What undoes an edit that was accepted, according to the state before it."""
        operation = entry.message.get("op")
        if operation == "set_options":
            back = self._served_with.inverse(entry.message)
            return [back] if len(back) > 1 else []  # it named no option
        if operation in CUTS:  # back to where it was: continue the frames before the cut
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
