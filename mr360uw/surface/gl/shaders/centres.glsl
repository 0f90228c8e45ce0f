// Lengths, normal and masks of the ray through a pixel's centre. Held to surface/sea_picture.py
// lengths: to what is met first and in the water, -1 for infinity; whether that is the surface, the floor
void set_centre(Waves waves, sampler2D heights, vec3 origin, vec3 direction, bool wet, Hit hit, float floor_y_m,
                float refractive_index, float width, float spread, out vec4 lengths, out vec4 normal) {
    bool met = hit.distance >= 0.0, seen = direction.y < 0.0 && (wet || floor_y_m > waves.lowest_m);
    float far = seen ? max((floor_y_m - origin.y) / direction.y, 0.0) : NO_HIT;
    float distance = met ? hit.distance : far, in_water = wet ? distance : 0.0;
    normal = met ? vec4(normal_of(hit.slope), 1.0) : vec4(0.0);
    if (!wet) {
        vec3 bent = normalize(refract_clamped(direction, normal.xyz, 1.0 / refractive_index));
        vec3 point = origin + hit.distance * direction;
        float below = bent.y < 0.0 ? max((floor_y_m - point.y) / bent.y, 0.0) : NO_HIT;
        Hit again = first_hit(waves, heights, point, bent, -1.0, width, spread, below < 0.0 ? FARTHEST_M : below, true);
        in_water = met ? (again.distance >= 0.0 ? again.distance : below) : 0.0;
    }
    lengths = vec4(distance, in_water, met ? 1.0 : 0.0, !met && seen ? 1.0 : 0.0);
}
