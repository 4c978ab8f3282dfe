"""A process of its own for what participants send, with limits on time and memory."""
