"""The commands: argument plumbing only."""
