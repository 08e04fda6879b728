"""The load generator of `motiongen bench`: an open loop with real-time playback; latencies count from intended times.

`scenario` defines a load, `schedule` draws it before the run, `generator` plays it in a process of its own, `run`
connects processes, server and progress, `search` looks for the most characters, `result` and `report` present the
results. Needs the extra: `pip install 'motiongen-tools[bench]'`.
"""
