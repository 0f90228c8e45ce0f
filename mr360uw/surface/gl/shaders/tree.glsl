// All rays that come of one, by a stack of those that wait. Held to surface/ray_tree.py
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

vec3 light_of(Ray ray, inout bool whole, out Hit hit) {
    vec3 total = vec3(0.0);
    bool more;
    int rays = 0;
    do {
        float far = floor_distance(ray.origin, ray.direction, ray.wet), up = ray.direction.y;
        hit = next_hit(ray, far);
        bool met = hit.distance >= 0.0, ends = !met && far < 0.0;
        float distance = met ? hit.distance : far;
        if (ray.wet) {
            Passage water = from_surface_on(ends ? FOREVER_M : distance, up), other = water;
            if (CAMERA_IN_WATER) other = from_camera_on(ends ? FOREVER_M : distance, up);
            if (ray.generation == 0) water = other;
            total += ray.weight * water.veil;
            ray.weight *= ends ? WATER_ENDS * water.passed : water.passed;
        }
        more = false;
        if (met) {
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
