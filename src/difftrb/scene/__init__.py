"""What is simulated: a scene, checked, from Python or a file; its laws made ready; its solution, and its audit."""
