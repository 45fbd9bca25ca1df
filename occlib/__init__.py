"""See around the occluder: two views in, an occlusion-free floor map out.

One module per stage of Khan & Choudhry (2009); ``Pipeline`` strings them together.
"""

__version__ = "0.1.0"
