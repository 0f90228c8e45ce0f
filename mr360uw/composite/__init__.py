# SPDX-License-Identifier: Apache-2.0
"""Meshes in a plate: shading, shadows, differential rendering.

`reference.render_layer` defines the layer of a `Shot`; `gl.layer_renderer.LayerRenderer` computes the same on OpenGL.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
