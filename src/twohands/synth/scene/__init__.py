"""What is drawn: people, their poses and motion, what they wear and hold, light and camera."""
