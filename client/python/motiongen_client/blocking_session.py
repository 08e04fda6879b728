"""Session without asyncio: every call hands its work to the client's background thread and waits."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from numpy.typing import ArrayLike

from motiongen_client import edit, session
from motiongen_client.background_loop import BackgroundLoop
from motiongen_client.blocking_callback import BlockingCallback
from motiongen_client.blocking_edit import Edit
from motiongen_client.motion import Frame, Motion, Rig
from motiongen_client.prompts import Prompt
from motiongen_client.session import SessionStats
from motiongen_client.types import (
    Constraint,
    ConstraintReached,
    Opened,
    Priority,
    Reopened,
    ServiceLevel,
    SessionEnd,
)


class Session:
    """One character. `motiongen_client.Session` has the same methods and callbacks, and describes them in full.

    Callbacks run on the client's background thread, where calls of methods here raise MotiongenError.
    """

    on_service_level = BlockingCallback[ServiceLevel]()
    on_constraint_reached = BlockingCallback[ConstraintReached]()
    on_durability = BlockingCallback[bool]()
    on_reopened = BlockingCallback[Reopened]()

    def __init__(self, loop: BackgroundLoop, inner: session.Session) -> None:
        self._loop = loop
        self._inner = inner
        self._glance: session.Glance | None = None

    @property
    def opened(self) -> Opened:
        """What the server chose for the session."""
        return self._inner.opened

    @property
    def rig(self) -> Rig:
        return self._inner.rig

    @property
    def service_level(self) -> ServiceLevel:
        """How well the server serves it at present."""
        return self._inner.service_level

    @property
    def is_paused(self) -> bool:
        """Whether the session is paused."""
        return self._inner.is_paused

    @property
    def is_away(self) -> bool:
        """Whether its connection was lost and the session has not continued yet."""
        return self._inner.is_away

    @property
    def is_durable(self) -> bool:
        """Whether its server saves it, so that another server can continue it."""
        return self._inner.is_durable

    @property
    def durable_seq(self) -> int:
        """Every event up to this number survives the loss of the server."""
        return self._inner.durable_seq

    @property
    def last_seq(self) -> int:
        """The number of the newest event."""
        return self._inner.last_seq

    @property
    def reopenings(self) -> tuple[Reopened, ...]:
        """One entry for each time that the session could not be resumed and was opened anew, of the last 256."""
        return self._inner.reopenings

    @property
    def end(self) -> SessionEnd | None:
        """How the session ended; None while it lives."""
        return self._inner.end

    @property
    def stats(self) -> SessionStats:
        """Counts and times so far, also after the client was closed."""
        return self._loop.look(lambda: self._inner.stats)

    def set_prompt(
        self, prompt: Prompt, *, frame: int | None = None, end_frame: int | None = None, prompt_id: int | None = None
    ) -> Edit:
        """Direct the motion by a text, now or from a frame on, to the end or up to another frame."""
        return self._edit(lambda: self._inner.set_prompt(prompt, frame=frame, end_frame=end_frame, prompt_id=prompt_id))

    def remove_prompts(self, prompt_ids: Iterable[int]) -> Edit:
        """Remove prompts by their ids (`Edit.prompt_id`)."""
        return self._edit(lambda: self._inner.remove_prompts(prompt_ids))

    def add_waypoint(
        self, x_m: float, z_m: float, *, frame: int, last_frame: int | None = None, heading_rad: float | None = None
    ) -> Edit:
        """Be at a ground position (world metres) at a frame, or at any frame from `frame` to last_frame."""
        return self._edit(
            lambda: self._inner.add_waypoint(x_m, z_m, frame=frame, last_frame=last_frame, heading_rad=heading_rad)
        )

    def go_to(self, x_m: float, z_m: float, *, heading_rad: float | None = None, is_relative: bool = False) -> Edit:
        """Walk to a ground position, as soon as a person can be there."""
        return self._edit(lambda: self._inner.go_to(x_m, z_m, heading_rad=heading_rad, is_relative=is_relative))

    def follow_path(
        self, corners_m: ArrayLike, *, speed_mps: float | None = None, smoothing_m: float | None = None
    ) -> Edit:
        """Walk from here along straight lines through corners_m (N, 2), world x, z in metres; stand at the last."""
        return self._edit(lambda: self._inner.follow_path(corners_m, speed_mps=speed_mps, smoothing_m=smoothing_m))

    def teleport(self, x_m: float, z_m: float, *, heading_rad: float = 0.0) -> Edit:
        """Stand at a ground position with a heading, from the first frame that can still change."""
        return self._edit(lambda: self._inner.teleport(x_m, z_m, heading_rad=heading_rad))

    def cut_to(self, prior: Motion) -> Edit:
        """Continue from other frames, as if they had come just before."""
        return self._edit(lambda: self._inner.cut_to(prior))

    def seek(self, frame: int) -> Edit:
        """Continue from one of the session's own frames, as if the frames before it had just been shown."""
        return self._edit(lambda: self._inner.seek(frame))

    def set_options(
        self,
        *,
        priority: Priority | None = None,
        lookahead_frames: int | None = None,
        denoise_steps: int | None = None,
        guidance: tuple[float | None, float | None] | None = None,
        history_frames: int | None = None,
    ) -> Edit:
        """Change options of the session, from the next window on."""
        return self._edit(
            lambda: self._inner.set_options(
                priority=priority,
                lookahead_frames=lookahead_frames,
                denoise_steps=denoise_steps,
                guidance=guidance,
                history_frames=history_frames,
            )
        )

    def add_trajectory(
        self, positions_m: ArrayLike, *, first_frame: int, headings_rad: ArrayLike | None = None
    ) -> Edit:
        """Be at positions_m (N, 2), world x, z in metres, one per frame; headings_rad (N,)."""
        return self._edit(
            lambda: self._inner.add_trajectory(positions_m, first_frame=first_frame, headings_rad=headings_rad)
        )

    def add_constraints(self, constraints: Iterable[Constraint]) -> Edit:
        """Add constraints to the present ones."""
        return self._edit(lambda: self._inner.add_constraints(constraints))

    def replace_constraint(self, constraint_id: int, constraint: Constraint) -> Edit:
        """Replace a constraint by its id."""
        return self._edit(lambda: self._inner.replace_constraint(constraint_id, constraint))

    def add_heading(self, heading_rad: float, *, frame: int) -> Edit:
        """Face a direction (radians, 0 toward +Z) at a frame, wherever the character is."""
        return self._edit(lambda: self._inner.add_heading(heading_rad, frame=frame))

    def set_constraints(self, constraints: Iterable[Constraint]) -> Edit:
        """Replace all constraints with these."""
        return self._edit(lambda: self._inner.set_constraints(constraints))

    def remove_constraints(self, constraint_ids: Iterable[int]) -> Edit:
        """Remove constraints by their ids (`Edit.constraint_ids`)."""
        return self._edit(lambda: self._inner.remove_constraints(constraint_ids))

    def clear_constraints(self) -> Edit:
        """Remove all constraints."""
        return self._edit(self._inner.clear_constraints)

    def set_velocity(
        self,
        x_mps: float,
        z_mps: float,
        *,
        seconds: float = 1.0,
        heading_rad: float | None = None,
        keep_prompt: bool = False,
    ) -> Edit:
        """Move over the ground at a velocity in metres per second, for `seconds` or until the next call."""
        return self._edit(
            lambda: self._inner.set_velocity(
                x_mps, z_mps, seconds=seconds, heading_rad=heading_rad, keep_prompt=keep_prompt
            )
        )

    def pause(self) -> Edit:
        """Stop the playhead."""
        return self._edit(self._inner.pause)

    def resume(self) -> Edit:
        """Let the playhead go on after `pause`."""
        return self._edit(self._inner.resume)

    def constraint_reached(self, constraint_id: int) -> ConstraintReached:
        """What became of a constraint, by an id of `Edit.constraint_ids`; waits until its last frame cannot change."""
        return self._loop.run(self._inner.constraint_reached(constraint_id))

    def frame_in(self, seconds: float) -> int:
        """The frame that will be shown `seconds` from now."""
        return self._loop.look(lambda: self._inner.frame_in(seconds))

    def frames(self, seconds: float | None = None, *, realtime: bool = True) -> Iterator[Frame]:
        """Each frame once, in order, in real time or as fast as they are generated."""
        frames = self._inner.frames(seconds, realtime=realtime)

        async def following() -> Frame | None:
            return await anext(frames, None)

        try:
            while (frame := self._loop.run(following())) is not None:
                yield frame
        finally:
            self._loop.leave(frames)

    def poll(self) -> Frame | None:
        """Move the playhead to the present and return the frame to show now; None before the first has arrived.

        While the same frame is due and nothing has arrived, this neither waits for the client's thread nor locks.
        """
        glance = self._glance
        if glance is None or not self._inner.is_same(glance):
            self._glance = glance = self._loop.call(self._inner.glance)
        return glance.frame

    def sample(self) -> Frame | None:
        """As `poll`, but with the pose interpolated between two frames for this moment."""
        return self._loop.call(self._inner.sample)

    def set_time_scale(self, scale: float) -> None:
        """Play slower or faster than real time: 0.5 is half as fast."""
        self._loop.call(lambda: self._inner.set_time_scale(scale))

    def motion(self, first_frame: int | None = None, end_frame: int | None = None) -> Motion:
        """The frames shown so far that are still kept, or those from first_frame up to end_frame - 1."""
        return self._loop.look(lambda: self._inner.motion(first_frame, end_frame))

    def close(self) -> SessionEnd:
        """End the session. Returns how it ended; calling it again returns the same."""
        return self._inner.end or self._loop.run(self._inner.close())

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._loop.finish(self._inner.__aexit__(*exc_info))

    def _edit(self, make: Callable[[], edit.Edit]) -> Edit:
        return Edit(self._loop, self._loop.call(make))
