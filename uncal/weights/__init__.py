"""Train once, ask often: trained weights and stochastic passes, found again by what made them."""
