"""The node `odo_align`."""
