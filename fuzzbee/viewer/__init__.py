"""The viewer: what it shows, and the process that shows it."""
