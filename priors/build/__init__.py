"""Build a prior: drive x method x filters -> cache. What is there already is not made again.

From Python:

    job = build.prepare(open_drive(Path("street")), Stereo())
    prior = job.run().prior

`priors build` does the same, and prints what `Job.plan` says between the two.
"""

from priors.build.job import BuildReport as BuildReport
from priors.build.job import Job as Job
from priors.build.plan import Plan as Plan
from priors.build.prepare import prepare as prepare
