"""The study of drills: practice against hostiles that repel instead of destroying."""
