"""What people and machines read of one solution: text, JSON, figures."""
