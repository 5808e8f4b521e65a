"""The membrane under a tool tip: section 6.2 of the paper."""
