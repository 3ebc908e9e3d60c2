"""Search of parameters: bee colony and others, objectives, checkpoint, cluster."""
