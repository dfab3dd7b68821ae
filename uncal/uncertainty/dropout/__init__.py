"""MC dropout for any network."""
