"""The beam under traction: section 6.1 of the paper."""
