"""The site of ``./run docs``: the pages of the repository, and a reference generated from the code."""
