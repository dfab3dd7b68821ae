"""Interval methods: split conformal prediction, its relatives, and their coverage laws."""
