"""What is behind the hands: photographs, films, panoramas and procedural pictures."""
