"""The live page and its stream: hands.jsonl line by line, to any client (docs/stream.md)."""
