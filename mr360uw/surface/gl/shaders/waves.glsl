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

// side: 1 for rays in air, -1 in water. leaves: the ray starts on the surface
Hit first_hit(Waves waves, sampler2D atlas, vec3 origin, vec3 direction, float side, float width, float spread,
              float reach, bool leaves) {
    Hit hit = Hit(NO_HIT, vec2(0.0), 0.0, 0.0);
    float dy = direction.y, across = length(direction.xz), t = 0.0, end = reach;
    if (dy > 0.0) {
        t = max((waves.lowest_m - origin.y) / dy, 0.0);
        end = min(end, (waves.highest_m - origin.y) / dy);
    } else if (dy < 0.0) {
        t = max((waves.highest_m - origin.y) / dy, 0.0);
        end = min(end, (waves.lowest_m - origin.y) / dy);
    } else if (origin.y < waves.lowest_m || origin.y > waves.highest_m) {
        return hit;
    }
    bool steep = is_steep(waves, direction);
    if (t > end || (steep && (leaves || side * dy > 0.0))) return hit;
    float low = t, high = (dy > 0.0 ? waves.highest_m : waves.lowest_m) - origin.y;
    high = steep ? high / dy : end;
    float speed = abs(dy) + waves.steepest * across, before = t, was = 0.0;
    bool ended = steep;
    if (leaves && t == 0.0) t = min(0.5 * max(waves.step_m, sigma_at(width, spread, t, dy)), end);
    for (int step = 0; step < MOST_STEPS && !ended; ++step) {
        float s = sigma_at(width, spread, t, dy);
        int level = int(level_at(waves, s) + 0.5);
        float height = waves_texel(waves, atlas, level, fract((origin.xz + t * direction.xz) / waves.tile_m)).x;
        float over = side * (origin.y + t * dy - height);
        if (over <= 0.0 && was > 0.0) {
            low = before;
            high = t;
            hit.distance = mix(before, t, was / (was - over));
        }
        ended = hit.distance >= 0.0 || t >= end;
        before = t;
        was = over <= 0.0 ? was : over;
        t = min(t + max(abs(over) / speed, 0.5 * max(waves.step_m, s)), end);
    }
    if (!steep && hit.distance < 0.0) return hit;
    t = clamp(steep ? -origin.y / dy : hit.distance, low, high);
    vec4 here;
    for (int step = 0; step < NEWTON_STEPS; ++step) {
        hit.sigma_m = sigma_at(width, spread, t, dy);
        hit.level = level_at(waves, hit.sigma_m);
        here = waves_at(waves, atlas, origin.xz + t * direction.xz, hit.level);
        float rate = dy - dot(here.yz, direction.xz);
        t = clamp(t - (origin.y + t * dy - here.x) / (abs(rate) < 1e-6 ? 1e-6 : rate), low, high);
    }
    hit.distance = t > reach ? NO_HIT : t;
    hit.slope = here.yz;
    return hit;
}
