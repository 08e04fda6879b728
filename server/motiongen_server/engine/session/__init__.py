"""One character: its motion so far, what steers it, and its next window.

`state` holds all that is known of it; `events.apply`, `planning` (next_window, accept) and `emission.emit` change it.
They are deterministic in the state and their arguments; time is passed as `now`, and they affect nothing else but the
outputs that they return and the counts in the StepReport. The rules:

- Frames below `committed_to` never change, and `committed_to` never falls.
- A window starts at the end of the plan, or at a frame that the client cannot have played when the window lands. One
  that lands too late is discarded, and its edits are tried again with a longer lead.
- Where the window of an edit starts is settled when the runner takes it: its duration depends on the batch.
- All edits that wait when a window starts are answered by that window. An edit that arrives while a window runs cuts
  the window (a prompt that starts inside it), joins it (it has not begun), restarts it (it answers no edit, and less
  than half of its steps are done), or follows it.
- Each class has a maximum rate of replans, and one in reserve after a quiet time; edits in between wait and share one.
  Edits are answered however long it takes.
- A window is used only up to the next change of prompt, so that the window after it starts there with the new prompt.
- No frame is sent at or beyond the playhead + lookahead, where the playhead runs hardly faster than real time.
- A constraint is answered when its last frame is committed: met or missed, and by how much.
- A session that is held makes no windows; it repeats its last pose when it would run out of frames.
- A clip is not played: windows follow one another until it has all its frames, and each is sent when it lands, but
  never more than its lookahead beyond what its client has taken.
"""
