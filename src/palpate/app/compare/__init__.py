"""Linear reductions of a body side by side: ``palpate compare``."""
