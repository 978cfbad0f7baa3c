"""Scene adaptation: fine-tune a single-image network on the drive that it is asked about."""
