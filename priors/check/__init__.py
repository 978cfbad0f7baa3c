"""The audit of a drive: what would spoil depth maps, one line a finding. `check(drive)` is the door."""

from priors.check.audit import check as check
from priors.check.finding import Finding as Finding
