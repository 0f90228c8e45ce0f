// All rays that come of one, by a stack of those that wait. Held to surface/tracing/ray_kernel.py
const float FOREVER_M = 1e9;

vec4 kept_origin[STACK], kept_direction[STACK], kept_weight[STACK];
uvec2 kept_state[STACK];
int kept = 0;

void keep(Ray ray) {
    kept_origin[kept] = vec4(ray.origin, ray.width);
    kept_direction[kept] = vec4(ray.direction, ray.spread);
    kept_weight[kept] = vec4(ray.weight, ray.lobe);
    kept_state[kept] = uvec2(ray.key, uint(2 * ray.generation) + (ray.wet ? 1u : 0u));
    ++kept;
}

Ray taken() {
    --kept;
    vec4 o = kept_origin[kept], d = kept_direction[kept], w = kept_weight[kept];
    uvec2 state = kept_state[kept];
    return Ray(o.xyz, d.xyz, w.xyz, o.w, d.w, w.w, state.x, int(state.y >> 1u), (state.y & 1u) == 1u);
}

Displacement level_displacement(int level, vec2 rest) {
    int full = waves.points, halved = max(level - 3, 0), n = max(full >> max(level - 2, 0), 4);
    int top = min(level, 3) * full + full - (full >> halved);
    float per_m = float(n) / waves.tile_m;
    return displacement(coefficients, top, n, per_m, rest * per_m);
}

// slopes by the splines themselves: between the points of the atlas they are linear, off by 1e-3
vec2 exact_slope(Ray ray, Hit hit) {
    vec2 place = ray.origin.xz + hit.distance * ray.direction.xz;
    vec2 rest = waves.tile_m * fract((place - waves_at(waves, shifts, place, hit.level).xy) / waves.tile_m);
    int lower = min(int(hit.level), waves.last - 1);
    Displacement a = level_displacement(lower, rest), b = level_displacement(lower + 1, rest);
    float share = hit.level - float(lower);
    Displacement d = Displacement(mix(a.value, b.value, share), mix(a.by_a, b.by_a, share), mix(a.by_b, b.by_b, share));
    return slope_over_places(d, area_ratio(d));
}

vec3 light_of(Ray ray, inout bool whole, out Hit hit) {
    vec3 total = vec3(0.0);
    bool more;
    int rays = 0;
    do {
        float far = floor_distance(ray.origin, ray.direction, ray.wet);
        hit = next_hit(ray, far);
        bool met = hit.distance >= 0.0, ends = !met && far < 0.0;
        float distance = met ? hit.distance : far;
        if (ray.wet) {
            Passage water = from_surface_on(ends ? FOREVER_M : distance, ray.direction), other = water;
            if (CAMERA_IN_WATER) other = from_camera_on(ends ? FOREVER_M : distance, ray.direction);
            if (ray.generation == 0) water = other;
            total += ray.weight * water.veil;
            ray.weight *= ends ? WATER_ENDS * water.passed : water.passed;
        }
        more = false;
        if (met) {
            hit.slope = exact_slope(ray, hit);
            Parting two = parting(ray, hit);
            total += ray.weight * two.glitter;
            bool back = brightest(two.reflected.weight) > brightest(two.refracted.weight);
            Ray other = two.refracted;
            ray = two.reflected;
            if (!back) {
                other = two.reflected;
                ray = two.refracted;
            }
            bool young = ray.generation < GENERATIONS;
            more = young && brightest(ray.weight) > FAINTEST;
            if (young && brightest(other.weight) > FAINTEST && kept < STACK) keep(other);
        } else if (far >= 0.0) {
            total += ray.weight * floor_light(ray, far, ray.wet);
        } else {
            total += ray.weight * (ray.wet ? lost_light : sky_light(ray));
        }
        if (!more && kept > 0) {
            ray = taken();
            more = true;
        }
    } while (more && ++rays < RAYS);
    kept = 0;
    return total;
}
