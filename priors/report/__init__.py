"""Report pages: tables, plots and pictures of what was made, in one HTML file that opens without a network."""
