"""The same work done with other tools, each as a competent user of that tool would write it."""
