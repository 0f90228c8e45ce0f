// twin: sampling.py
vec2 frame_from_raster(vec2 p, vec2 g) {
    return vec2(g.x * p.x + g.y * p.y, g.x * p.y - g.y * p.x) / dot(g, g);
}

vec2 raster_from_frame(vec2 p, vec2 g) {
    return vec2(g.x * p.x - g.y * p.y, g.y * p.x + g.x * p.y);
}
