// twin: shadow.py
// `sun_map` holds for every body a square slot of columns along the sun: (top, -bottom) of what fills them, in metres
// along the sun's axis. Loops test at their end, because software drivers run a body once more to leave. The twin shoots rays at the bodies instead.
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
    vec2 inside = clamp(p, 0.0, 0.99999);
    vec2 column = texelFetch(sun_map, caster.slot * slot_size + ivec2(inside * float(slot_size)), 0).rg;
    return p == inside ? column : vec2(-1e9);
}

// whether the ray from p, one metre along the sun's axis for `slope` metres across, meets the body
bool sun_blocked(sampler2D sun_map, Caster caster, int slot_size, vec3 p, vec2 slope, int starts) {
    float texel = 2.0 * caster.half_size / float(slot_size);
    vec2 range = max(caster.reach - p.z, 0.0);
    bool blocked = false;
    int k = 0;
    do {
        float h = mix(range.x, range.y, (float(k) + 0.5) / float(starts));
        vec2 column = sun_column(sun_map, caster, slot_size, p.xy + slope * h);
        float meets = min(max(h, -column.y - p.z), column.x - p.z);
        vec2 there = sun_column(sun_map, caster, slot_size, p.xy + slope * meets);
        bool met = there.x > p.z + meets - texel && -there.y < p.z + meets + texel && there.x > p.z;
        blocked = blocked || (column.x > -1e8 && meets > 0.0 && (meets == h || met));
        ++k;
    } while (k < starts && !blocked);
    return blocked;
}

// p: in the sun's axes (two across, one along). slopes: of the directions over the sun's disc. spread: the largest
float sun_visibility(sampler2D sun_map, sampler2D casters, int caster_count, int slot_size, vec3 p,
                     vec2 slopes[MAXIMUM_SUN_SAMPLES], int count, float spread) {
    int blocked = 0, number = 0, hits = 0;
    do {
        Caster caster = fetch_caster(casters, number);
        float above = caster.reach.y - p.z;
        vec2 across = abs(p.xy - caster.center) - caster.half_size;
        bool reached = above > 0.0 && max(across.x, across.y) <= spread * above;
        float travel = spread * (above - max(caster.reach.x - p.z, 0.0)) * float(slot_size) / caster.half_size;
        int starts = clamp(int(travel * 0.25) + 1, 1, 4);
        int k = reached ? 0 : count;
        do {
            bool is_new = k < count && (blocked & (1 << k)) == 0;
            if (is_new && sun_blocked(sun_map, caster, slot_size, p, slopes[min(k, count - 1)], starts)) {
                blocked |= 1 << k;
                ++hits;
            }
            ++k;
        } while (k < count);
        ++number;
    } while (number < caster_count);
    return 1.0 - float(hits) / float(count);
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
