"""Other people's networks: layers widened for a task with more inputs or outputs (needs the extra ``torch``)."""
