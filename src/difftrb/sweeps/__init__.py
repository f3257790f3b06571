"""Many scenes: axes, batches, chunks on disk. The public function is `difftrb.sweep`."""
