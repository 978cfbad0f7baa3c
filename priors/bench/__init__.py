"""Run time against error: every way to make depth on the same frames of a drive, in turn.

    entrants.py   who takes part: methods with their models, sizes and runtimes, and baselines
    baselines.py  what others do: OpenCV's matcher, the morphological recipe
    psmnet.py     PSMNet, from files of the user's
    race.py       the entrants in turn, from frame to frame
    memory.py     the peak memory of a process of its own
    results.py    what was measured, as JSON; what is there is not measured again
    front.py      which entrants no other beats
    table.py      the table and the plot
    sweep.py      how time and memory grow with the work
    budget.py     the entrant for a time or an error

`priors bench` prints and writes it, `priors build --budget` reads it.
"""
