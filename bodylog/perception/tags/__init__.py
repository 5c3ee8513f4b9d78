"""Tags and boards in images: quads, codes, corners."""
