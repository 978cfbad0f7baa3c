"""What a drive does not need, as a plan that a user can read.

needs.py       what each method must read, and what the drive has of it
skips.py       what can be left out: cached and still frames, rows of sky, disparities, held-out views
way.py         which method suits a drive: `priors build --method auto`
choice.py      which of a drive's priors a fit should lean on: `nerf fit --prior auto`
wish.py        which prior is worth its time, for these views and this aim
drive_plan.py  all of it: `priors plan`
"""
