// Light on a ray that meets the surface once at the most. Held to surface/tracing/ray_kernel.py
const float FOREVER_M = 1e9;

// of a ray in the water that does not meet the surface
vec3 wet_end(Ray ray, float far) {
    return far < 0.0 ? lost_light : floor_light(ray, far, true);
}

#ifdef DIRECT
vec3 light_of(Ray ray, inout bool whole, out Hit hit) {
    float far = floor_distance(ray.origin, ray.direction, CAMERA_IN_WATER);
    hit = Hit(NO_HIT, vec2(0.0), 0.0, 0.0);
    if (!CAMERA_IN_WATER) return sky_light(ray);
    Passage water = from_camera_on(far, ray.direction);
    return water.veil + water.passed * wet_end(ray, far);
}
#else
vec3 light_of(Ray ray, inout bool whole, out Hit hit) {
    float far = floor_distance(ray.origin, ray.direction, CAMERA_IN_WATER);
    hit = next_hit(ray, far);
    bool met = hit.distance >= 0.0;
    Passage first = Passage(vec3(0.0), vec3(1.0));
    if (CAMERA_IN_WATER) {
        first = from_camera_on(met ? hit.distance : far < 0.0 ? FOREVER_M : far, ray.direction);
        if (!met && far < 0.0) first.passed *= WATER_ENDS;
    }
    ray.weight = first.passed;
    Parting two = parting(ray, hit);
    Ray wet = two.refracted, dry = two.reflected;
    if (CAMERA_IN_WATER) {
        wet = two.reflected;
        dry = two.refracted;
    }
    vec3 light = first.veil, glitter = met ? ray.weight * two.glitter : vec3(0.0);
    // one ray in the water and one in the air: of a pixel that does not meet the surface the camera's own is one of them
    if (!met) {
        wet.weight = dry.weight = vec3(0.0);
        if (CAMERA_IN_WATER) {
            wet = ray;
        } else {
            dry = ray;
            whole = whole && far < 0.0;  // a floor that stands out of the water
        }
    }
    float down = met || !CAMERA_IN_WATER ? floor_distance(wet.origin, wet.direction, true) : far;
    float dry_down = floor_distance(dry.origin, dry.direction, false);
    bool wet_seen = brightest(wet.weight) > FAINTEST, dry_seen = brightest(dry.weight) > FAINTEST;
    // of the two at most one is so flat that it may meet another wave: the other is far from the horizon
    bool wet_flat = wet_seen && !is_steep(waves, wet.direction), dry_flat = dry_seen && !is_steep(waves, dry.direction);
    bool both = wet_flat && dry_flat;
    vec3 flat_ = wet_flat ? wet.direction : dry.direction;
    float reach = wet_flat ? down : dry_down;
    reach = !met || !(wet_flat || dry_flat) ? -1.0 : reach < 0.0 ? FARTHEST_M : min(reach, FARTHEST_M);
    bool again = meets_again(waves, heights, wet.origin, flat_, wet_flat ? -1.0 : 1.0, wet.width,
                             wet_flat ? wet.spread : dry.spread, reach);
    whole = whole && !(met && (both || again || (dry_seen && dry_down >= 0.0)));
    Passage second = from_surface_on(down < 0.0 ? FOREVER_M : down, wet.direction);
    if (down < 0.0) second.passed *= WATER_ENDS;
    if (!met) second = Passage(vec3(0.0), vec3(1.0));
    light += wet_seen ? wet.weight * (second.veil + second.passed * wet_end(wet, down)) : vec3(0.0);
    light += dry_seen ? dry.weight * sky_light(dry) : vec3(0.0);
    whole = whole && brightest(glitter) <= GLARE * brightest(light);
    return light + glitter;
}
#endif
