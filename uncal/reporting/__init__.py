"""Tables, summaries and pictures for people."""
