"""Label maps: images whose voxels hold the number of an organ, read from files and turned into surfaces."""
