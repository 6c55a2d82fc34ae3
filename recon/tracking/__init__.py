"""T_world_camera of every frame. Start at tracker.py."""
