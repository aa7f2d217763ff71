"""Where images jump: silhouettes and shadow edges, and how the image changes when they move."""
