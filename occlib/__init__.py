"""See around the occluder: two views in, an occlusion-free floor map out.

Khan & Choudhry (2009), stage by stage; what goes beyond the paper stands in wings of its own.

The chain
    pipeline        Fig 3: frames in, map and objects out
    finding         objects as regions of the fused evidence
    identification  sections 3, 4: known objects in each view by SSD, and their actual size
    memory          what is not seen now stays on the map for a moment
    settings        the profiles paper, and, recommended; each stage's own settings stand beside its code
    running         a recording run through the chain, its results on disk
The paper's stages, none of which imports another
    calibration     section 2: a camera from pictures of a checkerboard (Figs 1, 2)
    floor_marks     section 2: where a camera sees the floor, from marks on it
    foreground      sections 2, 4: background, difference, shadows (Figs 4-6); Otsu's and other thresholds in threshold
    matching        section 3: SSD and the other template measures in measures, places, thresholds (Eq 1, 2)
    localization    section 4: centroid, contour, actual size by look-up (Fig 7, Eq 3-5)
    registration    sections 5, 6: views warped to the floor (Figs 9, 10)
    occlusion       section 5: AND and the other fusion rules (Figs 8, 11)
    tracking        section 4: object vectors M{p, V, C}, identities and speeds
    mapping         section 5: the occupancy map; files of ROS map_server
What the stages stand on
    geometry        camera, floor, rig: conventions and units
    lens            how a lens bends the picture: distort, undistort, where that is valid
    recordings      folders of pictures or videos, and the public ones that are fetched
    formats         rig, scene, truth, objects, messages, manifests: typed, read and checked
    base            files, arrays, interrupts, compiled loops, extras
What looks at the results
    metrics         scores against the truth: of detections (MODA), labels and sizes, maps
    plotting        colours of the map and of the cameras, views, overviews
Wings
    explaining      beyond AND: the fewest upright objects that explain all silhouettes
    live            live cameras; broadcast to robots (late joiners, too: in broadcast); messages; bags and topic of ROS
    robots          paths on the map, and right of way
    study           which measure, when: trials, sweeps, tables, charts
    lab             scenes with exact truth: rendering, crowds, missions; ghosts (false crossings of shadows) predicted and counted
Above them
    reproduce       notebooks run, figures and metrics published
    course          what the chapters are taught with: exercises that answer back, drawings, copies; the book
    cli             the command ``occlib``

>>> import occlib
>>> occlib.Rig.__module__
'occlib.geometry'
"""

import lazy_loader

__version__ = "0.1.0"

_NAMES = {
    "calibration": ["calibrate_images"],
    "foreground": ["learn_background"],
    "matching": ["compare", "find", "similarity"],
    "occlusion": ["fuse"],
    "mapping": ["OccupancyMap"],
    "pipeline": ["Pipeline", "Settings"],
    "geometry": ["Rig"],
    "recordings": ["open_recording"],
    "metrics": ["evaluate"],
}
_ROOMS = ["settings", "running", "floor_marks", "localization", "registration", "tracking", "identification"]
_ROOMS += ["finding", "memory", "lens", "formats", "plotting", "base"]
_WINGS = ["explaining", "live", "robots", "study", "lab", "reproduce", "course"]

# Loaded when first used: `import occlib` and `occlib --help` must not wait for OpenCV and Numba.
__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, [*_NAMES, *_ROOMS, *_WINGS], _NAMES)
