"""Ready-made bodies with their loads, one file each."""
