"""The node `swing_align`."""
