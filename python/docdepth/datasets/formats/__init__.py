"""The formats of recordings, a file each; see ``docdepth.datasets.format``."""
