// twin: shadow.py
// `sun_map` holds for every body a square slot of columns along the sun: (top, -bottom) of what fills them, in metres
// along the sun's axis. The twin shoots rays at the bodies instead.
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

vec2 sun_column(sampler2D sun_map, Caster caster, int slot_size, vec2 at) {
    vec2 p = (at - caster.center) / caster.half_size * 0.5 + 0.5;
    if (p != clamp(p, 0.0, 0.99999)) return vec2(-1e9);
    return texelFetch(sun_map, caster.slot * slot_size + ivec2(p * float(slot_size)), 0).rg;
}

// whether the ray from p, one metre along the sun's axis for `slope` metres across, meets the body
bool sun_blocked(sampler2D sun_map, Caster caster, int slot_size, vec3 p, vec2 slope, int starts) {
    float texel = 2.0 * caster.half_size / float(slot_size);
    vec2 range = max(caster.reach - p.z, 0.0);
    for (int k = 0; k < starts; ++k) {
        float h = mix(range.x, range.y, (float(k) + 0.5) / float(starts));
        vec2 column = sun_column(sun_map, caster, slot_size, p.xy + slope * h);
        if (column.x < -1e8) continue;
        float meets = clamp(h, -column.y - p.z, column.x - p.z);
        if (meets <= 0.0) continue;
        if (meets == h) return true;
        column = sun_column(sun_map, caster, slot_size, p.xy + slope * meets);
        if (column.x > p.z + meets - texel && -column.y < p.z + meets + texel && column.x > p.z) return true;
    }
    return false;
}

// p: in the sun's axes (two across, one along). slopes: of the directions over the sun's disc. spread: the largest
float sun_visibility(sampler2D sun_map, sampler2D casters, int caster_count, int slot_size, vec3 p,
                     vec2 slopes[MAXIMUM_SUN_SAMPLES], int count, float spread) {
    int blocked = 0;
    for (int number = 0; number < caster_count; ++number) {
        Caster caster = fetch_caster(casters, number);
        float above = caster.reach.y - p.z;
        if (above <= 0.0) continue;
        vec2 across = abs(p.xy - caster.center) - caster.half_size;
        if (max(across.x, across.y) > spread * above) continue;
        float travel = spread * (above - max(caster.reach.x - p.z, 0.0)) * float(slot_size) / caster.half_size;
        int starts = clamp(int(travel * 0.25) + 1, 1, 4);
        for (int k = 0; k < count; ++k) {
            if ((blocked & (1 << k)) == 0 && sun_blocked(sun_map, caster, slot_size, p, slopes[k], starts))
                blocked |= 1 << k;
        }
    }
    int free = 0;
    for (int k = 0; k < count; ++k) free += 1 - ((blocked >> k) & 1);
    return float(free) / float(count);
}

// surfels: (place, 0) and (area vector, 0) in turn
float ambient_blocked(sampler2D surfels, int first, int count, vec3 point, vec3 normal) {
    float total = 0.0;
    for (int k = first; k < first + count; ++k) {
        vec3 towards = texelFetch(surfels, ivec2(0, k), 0).xyz - point;
        vec4 vector = texelFetch(surfels, ivec2(1, k), 0);
        float squared = max(dot(towards, towards), 1e-12);
        float facing = abs(dot(towards, vector.xyz)) * max(dot(towards, normal), 0.0);
        total += facing / (squared * (PI * squared + vector.w));
    }
    return total;
}
