"""Jobs of a run that workers execute: tiles, overviews, labels."""
