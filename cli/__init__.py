"""The `uncle` command line."""
