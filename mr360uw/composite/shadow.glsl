// twin: shadow.py
// `sun_map` holds for every body (or group of them) a square slot of columns along the sun: (1, top, bottom) of what
// fills them, metres above the lowest, 0 where nothing does; filtered, so that edges are not steps. Loops test at their end, because software drivers run a body once more to leave. The twin shoots rays at the bodies instead.
const int MAXIMUM_SUN_SAMPLES = 32;

struct Caster {
    vec2 center;
    float half_size;
    vec2 reach;
    ivec2 slot;
};

Caster fetch_caster(sampler2D casters, int number) {
    vec4 place = texelFetch(casters, ivec2(0, number), 0), more = texelFetch(casters, ivec2(1, number), 0);
    return Caster(place.xy, place.z, more.xy, ivec2(more.zw));
}

// (part that is filled, top, bottom) at a place across the sun, between texels
vec3 sun_column(sampler2D sun_map, Caster caster, float slot_size, vec2 at) {
    vec2 p = (at - caster.center) / caster.half_size * 0.5 + 0.5;
    vec2 inside = clamp(p * slot_size, 0.5, slot_size - 0.5);
    vec4 column = textureLod(sun_map, (vec2(caster.slot) * slot_size + inside) / vec2(textureSize(sun_map, 0)), 0.0);
    column.yz = column.yz / max(column.x, 1e-6) + caster.reach.x;
    return p == clamp(p, 0.0, 1.0) ? column.xyz : vec3(0.0, column.yz);
}

// how far the ray from p, `slope` metres across for a metre along the sun's axis, is blocked by the body
float sun_blocked(sampler2D sun_map, Caster caster, float slot_size, vec3 p, vec2 slope, int starts) {
    float texels = 4.0 * caster.half_size / slot_size;
    vec2 range = max(caster.reach - p.z, 0.0);
    float blocked = 0.0;
    int k = 0;
    do {
        float h = mix(range.x, range.y, (float(k) + 0.5) / float(starts));
        vec3 column = sun_column(sun_map, caster, slot_size, p.xy + slope * h);
        float meets = min(max(h, column.z - p.z), column.y - p.z);
        vec3 there = sun_column(sun_map, caster, slot_size, p.xy + slope * meets);
        bool met = there.y > p.z + meets - texels && there.z < p.z + meets + texels && there.y > p.z;
        if (column.x > 0.0 && meets > 0.0 && met) blocked = max(blocked, there.x);
        ++k;
    } while (k < starts);
    return blocked;
}

// p: in the sun's axes (two across, one along). slopes: of the directions over the sun's disc. spread: the largest
float sun_visibility(sampler2D sun_map, sampler2D casters, int caster_count, float slot_size, vec3 p,
                     vec2 slopes[MAXIMUM_SUN_SAMPLES], int count, float spread, bool wanted) {
    int reached = 0, number = 0;
    do {
        Caster caster = fetch_caster(casters, number);
        float above = caster.reach.y - p.z;
        vec2 across = abs(p.xy - caster.center) - caster.half_size;
        if (wanted && above > 0.0 && max(across.x, across.y) <= spread * above) reached |= 1 << number;
        ++number;
    } while (number < caster_count);
    float blocked = 0.0;
    int k = reached == 0 ? count : 0;
    do {
        int left = reached;
        float most = 0.0;
        do {
            int lowest = left & -left;
            Caster caster = fetch_caster(casters, lowest == 0 ? 0 : int(log2(float(lowest)) + 0.5));
            float above = caster.reach.y - max(caster.reach.x, p.z);
            float travel = spread * above * slot_size / caster.half_size;
            bool asked = lowest != 0 && k < count;
            int starts = asked ? clamp(int(travel * 0.25) + 1, 1, 6) : 1;
            float one = sun_blocked(sun_map, caster, slot_size, p, slopes[min(k, count - 1)], starts);
            if (asked) most = max(most, one);
            left &= ~lowest;
        } while (left != 0 && most < 1.0);
        blocked += most;
        ++k;
    } while (k < count);
    return 1.0 - blocked / float(count);
}

// surfels: (place, 0) and (area vector, 0) in turn
float ambient_blocked(sampler2D surfels, int first, int count, vec3 point, vec3 normal) {
    float total = 0.0;
    int k = first;
    do {
        vec3 towards = texelFetch(surfels, ivec2(0, k), 0).xyz - point;
        vec4 vector = texelFetch(surfels, ivec2(1, k), 0);
        float squared = max(dot(towards, towards), 1e-12);
        float facing = abs(dot(towards, vector.xyz)) * max(dot(towards, normal), 0.0);
        total += facing / (squared * (PI * squared + vector.w));
        ++k;
    } while (k < first + count);
    return total;
}
