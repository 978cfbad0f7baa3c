"""Report pages: tables, plots and pictures of what was made, in one HTML file that opens without a network.

A page (page.py) has chapters, a chapter sections, a section blocks: each block is a class with a template of its own in
templates/. scores.py fills a chapter with a drive's priors.
"""
