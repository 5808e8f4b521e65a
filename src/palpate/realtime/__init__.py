"""Real-time engine: steps a model at a fixed rate against a moving tool.

`engine.py` is the object of a program, and `loop.py` the compiled thread that steps a body: it waits, reads the newest
pose, computes one period (`period.py`) and publishes a record. The thread never waits for a reader. The table
`PERIOD_FIELDS` (`record.py`) has the name, unit and shape of each value of a record; recordings and frames of the page
follow from it.

`channel.py` and `palpate_channel.h` pass poses and records through shared memory. `bodies` prepares reduced and full
bodies, changes their tools between two periods, and cuts them.
"""
