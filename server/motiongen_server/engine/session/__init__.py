"""One character: its motion so far, what steers it, and its next window.

`state` holds all that is known of it; `events.apply`, `planning` (next_window, accept) and `emission.emit` change it.
They are deterministic in the state and their arguments; time comes in as `now`, nothing goes out but what they return
and what they count in the StepReport. The rules:

- Frames below `committed_to` never change, and it never falls.
- A window starts at a commit frame, which the client cannot have played when the window lands, or at the end of the
  plan. One that lands too late is discarded, and its edits are tried again with a longer lead.
- Where a window of an edit starts is settled when the runner takes it: who goes along says how long it will be.
- All edits that wait when a window starts are answered by that window. One that arrives while a window runs cuts the
  window (a prompt that starts inside it), joins it (it has not begun), restarts it (it answers no edit, and less than
  half of its steps are done), or follows it.
- Each class has a most replans a second, and one more after a quiet time; edits in between wait and share one. They are
  answered however long it takes.
- A window is taken only up to the next change of prompt, so the window after it starts there with the new prompt.
- No frame is sent at or beyond the playhead + lookahead, of which the playhead runs at real time and little more.
- A constraint is answered when its last frame is committed: met or missed, and by how much.
- A session told to hold makes no windows; it repeats its last pose when it would run out.
- A clip is not played: windows follow one another until its frames are there, and each is sent when it lands; no more
  than its lookahead beyond what its client has taken.
"""
