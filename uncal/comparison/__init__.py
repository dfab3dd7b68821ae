"""Runs beside the published numbers: one page, one Markdown text, one tidy csv."""
