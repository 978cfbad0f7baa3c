"""How what is learned was learned: each file runs again from one command and rewrites a file in priors/weights."""
