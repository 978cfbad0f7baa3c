"""Pictures: colours of depth, error and confidence, panels of maps, plots."""
