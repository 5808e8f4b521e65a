"""A scene, run once or in real time."""
