"""Sets of pictures, each a pure function of its settings and a seed: static, dynamic, frames, streamed."""
