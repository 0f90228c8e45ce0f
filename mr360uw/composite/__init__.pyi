from .mesh.mesh import Mesh, load_mesh
from .motion import Motion, read_camera_track
from .receiver.shape import load_receiver
from .reference import render_layer
from .settings import DrawSettings, HoldoutSettings, ObjectSettings, ReceiverSettings
from .shot import PlacedObject, Receiver, SceneObject, Shot, load_object, load_objects
from .tiles import over_tile

__all__ = [
    "DrawSettings",
    "HoldoutSettings",
    "Mesh",
    "Motion",
    "ObjectSettings",
    "PlacedObject",
    "Receiver",
    "ReceiverSettings",
    "SceneObject",
    "Shot",
    "load_mesh",
    "load_object",
    "load_objects",
    "load_receiver",
    "over_tile",
    "read_camera_track",
    "render_layer",
]
