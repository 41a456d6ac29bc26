"""The same work done with other tools, each used as by an experienced user."""
