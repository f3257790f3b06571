"""What people and machines read of one solution: text, JSON, figures; and what the command line shows meanwhile."""
