"""Splits, datasets and the LightningDataModule."""
