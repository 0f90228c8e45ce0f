// First intersection of rays with the surface, on an atlas of heights over places. Held to surface/intersection.py
struct Waves {
    float tile_m;
    float step_m;
    float lowest_m;
    float highest_m;
    float steepest;
    int points;  // across the tile in level 0
    int last;  // level
};

struct Hit {
    float distance;  // negative for none
    vec2 slope;
    float sigma_m;
    float level;
};

const float LEAST_UP = 0.05;
const float PIXEL_SIGMA = 0.288675135;  // 1/sqrt(12)
const float NO_HIT = -1.0;
const int MOST_STEPS = 400;
const int NEWTON_STEPS = 3;
const float COARSE = 4.0;

float sigma_at(float width, float spread, float t, float up) {
    return PIXEL_SIGMA * (width + spread * t) * inversesqrt(max(abs(up), LEAST_UP));
}

float level_at(Waves waves, float sigma) {
    float s = sigma / waves.step_m;
    return min(s < 1.0 ? s : 1.0 + log2(s), float(waves.last));
}

// Levels 0, 1 and 2 have all points, each further one half as many, four at least: they lie below each other
vec4 waves_texel(Waves waves, sampler2D atlas, int level, vec2 tiles) {
    int full = waves.points;
    int size = max(full >> max(level - 2, 0), 4);
    int halved = max(level - 3, 0);
    int top = min(level, 3) * (full + 2) + (full - (full >> halved)) + 2 * halved;
    vec2 place = tiles * float(size) + vec2(1.5, float(top) + 1.5);
    return textureLod(atlas, place / vec2(textureSize(atlas, 0)), 0.0);
}

// of heights.frag: height and slopes, or the shift of particles
vec4 waves_at(Waves waves, sampler2D atlas, vec2 place, float level) {
    vec2 tiles = fract(place / waves.tile_m);
    int lower = min(int(level), waves.last - 1);
    return mix(waves_texel(waves, atlas, lower, tiles), waves_texel(waves, atlas, lower + 1, tiles),
               level - float(lower));
}

// steeper than any wave: a ray that crosses the surface at most once, and never after it has left it
bool is_steep(Waves waves, vec3 direction) {
    return abs(direction.y) > waves.steepest * length(direction.xz);
}

// from .. to: a part of a ray
struct Span {
    float from;
    float to;
};

// the part in the layer between trough and crest, empty with to < from
Span in_layer(Waves waves, vec3 origin, vec3 direction, float reach) {
    float dy = direction.y, entry = dy > 0.0 ? waves.lowest_m : waves.highest_m;
    float exit = dy > 0.0 ? waves.highest_m : waves.lowest_m;
    if (dy == 0.0) {
        bool inside = origin.y >= waves.lowest_m && origin.y <= waves.highest_m;
        return Span(0.0, inside ? reach : -1.0);
    }
    return Span(max((entry - origin.y) / dy, 0.0), min(reach, (exit - origin.y) / dy));
}

// The step in which a ray first crosses the surface, and the place in it by linear interpolation, negative for none.
// least: length of the shortest step in widths of points or of the footprint
float crossing(Waves waves, sampler2D atlas, vec3 origin, vec3 direction, float side, float width, float spread,
               bool leaves, float least, Span layer, out Span step_) {
    float t = layer.from, speed = abs(direction.y) + waves.steepest * length(direction.xz), found = NO_HIT;
    if (leaves && t == 0.0) {
        t = min(least * max(waves.step_m, sigma_at(width, spread, 0.0, direction.y)), layer.to);
    }
    step_ = Span(t, t);
    float was = 0.0;
    bool ended = t > layer.to;
    for (int k = 0; k < MOST_STEPS && !ended; ++k) {
        float s = sigma_at(width, spread, t, direction.y);
        int level = int(level_at(waves, s) + 0.5);
        float height = waves_texel(waves, atlas, level, fract((origin.xz + t * direction.xz) / waves.tile_m)).x;
        float over = side * (origin.y + t * direction.y - height);
        if (over <= 0.0 && was > 0.0) found = mix(step_.from, t, was / (was - over));
        ended = found >= 0.0 || t >= layer.to;
        step_.to = t;
        if (!ended) step_.from = t;
        was = over <= 0.0 ? was : over;
        t = min(t + max(abs(over) / speed, least * max(waves.step_m, s)), layer.to);
    }
    return found;
}

// side: 1 for rays in air, -1 in water. leaves: the ray starts on the surface
Hit first_hit(Waves waves, sampler2D atlas, vec3 origin, vec3 direction, float side, float width, float spread,
              float reach, bool leaves) {
    Span layer = in_layer(waves, origin, direction, reach), step_;
    bool steep = is_steep(waves, direction);
    bool free = layer.to < layer.from || (steep && (leaves || side * direction.y > 0.0));
    Span marched = Span(layer.from, free || steep ? -1.0 : layer.to);
    float t = crossing(waves, atlas, origin, direction, side, width, spread, leaves, 0.5, marched, step_);
    bool met = !free && (steep || t >= 0.0);
    float slack = 0.5 * max(waves.step_m, sigma_at(width, spread, step_.to, direction.y));
    Span allowed = Span(max(step_.from - slack, 0.0), step_.to + slack);
    if (steep) {
        allowed = in_layer(waves, origin, direction, FARTHEST_M);
        t = -origin.y / direction.y;
    }
    Hit hit;
    vec4 here;
    for (int k = 0; k < NEWTON_STEPS; ++k) {
        t = clamp(t, allowed.from, allowed.to);
        hit.sigma_m = sigma_at(width, spread, t, direction.y);
        hit.level = level_at(waves, hit.sigma_m);
        here = waves_at(waves, atlas, origin.xz + t * direction.xz, hit.level);
        float rate = direction.y - dot(here.yz, direction.xz);
        t -= (origin.y + t * direction.y - here.x) / (abs(rate) < 1e-6 ? 1e-6 : rate);
    }
    t = clamp(t, allowed.from, allowed.to);
    hit.distance = met && t <= reach ? t : NO_HIT;
    hit.slope = here.yz;
    return hit;
}

// whether a ray that starts on the surface meets it again
bool meets_again(Waves waves, sampler2D atlas, vec3 origin, vec3 direction, float side, float width, float spread,
                 float reach) {
    Span layer = in_layer(waves, origin, direction, reach), step_;
    return crossing(waves, atlas, origin, direction, side, width, spread, true, COARSE, layer, step_) >= 0.0;
}
