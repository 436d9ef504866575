"""The fused engine: loops compiled from functions, batches, tangents and replays."""
