"""Every setting, as small frozen models; presets by method."""
