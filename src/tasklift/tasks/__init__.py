"""What is learned: variables, tasks and their simplifications, policies and their extension."""
