"""Networks: one file each, on one shared trunk; runtime.py runs them, weights.py finds their weights."""
