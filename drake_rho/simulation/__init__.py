"""Flying it: winds to fly in, the worst of them among them."""
