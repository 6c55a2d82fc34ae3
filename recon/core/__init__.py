"""Types and tools that every room shares. No algorithm, no run directory."""
