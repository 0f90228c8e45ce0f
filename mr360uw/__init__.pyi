from . import caustics, composite, datasets, depth, from_above, ibl, medium, plot, surface, types, video
from .datasets import sweep
from .depth.clip_depth import DepthReport, depth_of_clip
from .errors import GlError, MeshError, Mr360uwError, OutputExistsError, ParameterError, SceneError, VideoError
from .from_above import AerialScene, aerial, load_aerial
from .render.first_pass import ClipAnalysis
from .runs.compositor import Compositor, FrameResult, analyse_clip, render_frame
from .runs.outputs import Report
from .runs.pipeline import composite_video
from .sample import sample_dive
from .scene import Scene, load_scene
from .track.camera_track import CameraTrack
from .track.floor_mesh import FloorMesh, floor_from_track
from .track.tracking import track_camera
from .types import CausticStack, Environment, Layer, Sun
from .video import open_video

__version__: str

__all__ = [
    "AerialScene",
    "CameraTrack",
    "CausticStack",
    "ClipAnalysis",
    "Compositor",
    "DepthReport",
    "Environment",
    "FloorMesh",
    "FrameResult",
    "GlError",
    "Layer",
    "MeshError",
    "Mr360uwError",
    "OutputExistsError",
    "ParameterError",
    "Report",
    "Scene",
    "SceneError",
    "Sun",
    "VideoError",
    "__version__",
    "aerial",
    "analyse_clip",
    "caustics",
    "composite",
    "composite_video",
    "datasets",
    "depth",
    "depth_of_clip",
    "floor_from_track",
    "from_above",
    "ibl",
    "load_aerial",
    "load_scene",
    "medium",
    "open_video",
    "plot",
    "render_frame",
    "sample_dive",
    "surface",
    "sweep",
    "track_camera",
    "types",
    "video",
]
