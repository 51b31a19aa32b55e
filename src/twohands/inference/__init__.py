"""From one picture to both hands in metres, on a plain CPU and without torch."""
