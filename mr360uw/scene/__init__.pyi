from .model import CameraSettings, PlateSettings, Scene, load_scene, scene_from_dict

__all__ = [
    "CameraSettings",
    "PlateSettings",
    "Scene",
    "load_scene",
    "scene_from_dict",
]
