"""What stochastic passes cost, and what they are worth."""
