"""The load generator behind `motiongen bench`: open loop, latency counted from intended times, real-time playback.

`scenario` says what load is, `schedule` draws it before the run, `generator` plays it in a process of its own, `run`
joins processes, server and progress together, `search` looks for the most characters, `result` and `report` say what
came of it. Needs the extra: `pip install 'motiongen-tools[bench]'`.
"""
