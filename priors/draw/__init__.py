"""Pictures for people: colours, panels of maps, plots, videos."""
