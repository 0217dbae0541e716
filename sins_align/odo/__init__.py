"""Alignment of a moving vehicle, aided by an odometer."""
