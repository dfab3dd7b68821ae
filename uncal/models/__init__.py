"""Backbones, heads, losses and the LightningModule around them."""
