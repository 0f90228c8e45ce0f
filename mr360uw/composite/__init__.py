# SPDX-License-Identifier: Apache-2.0
"""Objects that belong there: meshes, shading, shadows, differential rendering.

`reference.render_layer` defines the layer of a `Shot`; `gl.layer_renderer.LayerRenderer` draws the same on OpenGL.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
