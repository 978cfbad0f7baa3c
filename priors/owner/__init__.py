"""Who has a frame, a file or a folder in hand: `process.py` says who somebody is, `claim.py` takes and gives back."""
