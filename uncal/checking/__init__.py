"""Looking for the usual mistakes in recordings, on the form of files and on what the data show."""
