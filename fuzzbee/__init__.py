"""The command, and all that a person looks at."""
