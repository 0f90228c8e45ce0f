// Visible fraction of a directed light behind bodies, traced through filtered columns; the reference casts rays
// instead. Held to composite/lighting/light_sources.py.
// `sun_map` holds for every body (or group of bodies) a square slot of columns along the light: (filled fraction, top,
// bottom, opacity), the last three times the first, heights in metres above the lowest point, and means of 2x2, 4x4, ...
// of them. TRANSLUCENT: some bodies let light through, each column the product over its surfaces. A ray that
// starts within a column passes half of these.
// Loops test at their end, because software drivers execute a body once more to leave.
const float RAMP = 1.33;      // texels over which a filtered column rises from empty to filled at a straight edge
const float RAY_WIDTH = 1.2;  // width of a ray over that of the part of footprint and disc that it represents
const float SHARPEST = 0.2;   // least width of a sharpened edge, as a fraction of RAMP
const float SMALLEST = 4.0;   // texels across the last level of a slot
const int MAXIMUM_STEPS = 16;
const mat2x3 POINT = mat2x3(0.0);  // sides of the footprint of a point

// for all directed lights: texels across a slot of the atlas; directions over a light's disc; factor on the offset of
// shadow rays from the surface
struct Shadows {
    float slot_size;
    int samples;
    float bias_scale;
};

struct Caster {
    vec2 center;
    vec2 half_size;
    vec2 reach;
    vec2 slot;
};

Caster fetch_caster(sampler2D casters, int number) {
    vec4 place = texelFetch(casters, ivec2(0, number), 0), more = texelFetch(casters, ivec2(1, number), 0);
    return Caster(place.xy, place.zw, more.xy, more.zw);
}

// the largest power of two that is not above a positive number
float power_below(float x) {
    return uintBitsToFloat(floatBitsToUint(x) & 0x7f800000u);
}

// (filled fraction, top, bottom, opacity), the last three times the first, at a place of a slot in [0, 1]^2, from the
// level whose texels are `texels` of the finest wide; clamped to the slot
vec4 sun_texel(sampler2D sun_map, Caster caster, float slot_size, float texels, vec2 place) {
    vec2 inside = clamp(place * slot_size, 0.5 * texels, slot_size - 0.5 * texels);
    // levels lie beside the columns, each below the one before: software drivers are slow where each place has its own
    vec2 size = vec2(textureSize(sun_map, 0));
    vec2 corner = texels > 1.0 ? vec2(size.x / 1.5, size.y - 2.0 * size.y / texels) : vec2(0.0);
    return textureLod(sun_map, (corner + (caster.slot + inside) / texels) / size, 0.0);
}

// (blocked fraction, top, bottom) at a place across the light, a mean over `width` metres; edges are that wide, too.
// begin: height at which the ray starts
vec3 sun_column(sampler2D sun_map, Caster caster, float slot_size, vec2 at, float width, float begin) {
    float texel = 2.0 * max(caster.half_size.x, caster.half_size.y) / slot_size;
    float wanted = max(width / (RAMP * texel), SHARPEST);
    float texels = clamp(power_below(wanted * sqrt(2.0)), 1.0, slot_size / SMALLEST);
    vec2 place = (at - caster.center) / caster.half_size * 0.5 + 0.5;
    vec4 column = sun_texel(sun_map, caster, slot_size, texels, place);
    vec2 ends = column.yz / max(column.x, 1e-6) + caster.reach.x;
    // a partly filled column is taken as thinner, in proportion to the filled fraction
    float middle = 0.5 * (ends.x + ends.y), half_height = 0.5 * (ends.x - ends.y) * column.x;
    float filled = clamp((column.x - 0.5) * max(1.0 / wanted, 1.0) + 0.5, 0.0, 1.0);
    bool there = column.x > 0.0 && place == clamp(place, 0.0, 1.0);
#if defined(TRANSLUCENT)
    float passed = clamp(1.0 - column.w / max(column.x, 1e-6), 0.0, 1.0);
    bool within = begin < ends.x - 0.01 * texel && begin > ends.y - 0.01 * texel;
    filled *= 1.0 - (within ? sqrt(passed) : passed);
#endif
    return vec3(there ? filled : 0.0, middle + half_height, middle - half_height);
}

// blocked fraction of a ray between two heights, whose columns are a and b; linear between them
float blocked_between(vec3 a, vec3 b, float height_a, float height_b, float margin) {
    if (a.x <= 0.0) a.yz = b.yz;
    if (b.x <= 0.0) b.yz = a.yz;
    vec2 below = vec2(height_a - a.z, height_b - b.z) + margin, above = vec2(a.y - height_a, b.y - height_b) + margin;
    float cut_below = below.x / (below.x - below.y), cut_above = above.x / (above.x - above.y);
    float enter = max(below.x < 0.0 ? cut_below : 0.0, above.x < 0.0 ? cut_above : 0.0);
    float leave = min(below.y < 0.0 ? cut_below : 1.0, above.y < 0.0 ? cut_above : 1.0);
    bool beside = max(below.x, below.y) < 0.0 || max(above.x, above.y) < 0.0 || enter > leave;
    return beside ? 0.0 : max(mix(a.x, b.x, enter), mix(a.x, b.x, leave));
}

// blocked fraction of the ray from p, `slope` metres across for a metre along the light. It represents a cone of
// directions that is `grain` metres wide at p and widens by `widening` metres for a metre
float sun_blocked(sampler2D sun_map, Caster caster, float slot_size, vec3 p, vec2 slope, float grain, float widening) {
    float texel = 2.0 * max(caster.half_size.x, caster.half_size.y) / slot_size;
    vec2 range = max(caster.reach - p.z, 0.0);
    float across = max(length(slope), 1e-6), blocked = 0.0, h = range.x;
    vec3 here = sun_column(sun_map, caster, slot_size, p.xy + slope * h, grain + widening * h, p.z);
    int k = 1;
    do {
        float next = k < MAXIMUM_STEPS ? min(h + max(grain + widening * h, 0.5 * texel) / across, range.y) : range.y;
        vec3 there = sun_column(sun_map, caster, slot_size, p.xy + slope * next, grain + widening * next, p.z);
        blocked = max(blocked, blocked_between(here, there, p.z + h, p.z + next, 0.01 * texel));
        here = there;
        h = next;
        ++k;
    } while (h < range.y && blocked < 1.0);
    return blocked;
}

// blocked fraction of a ray that bodies block by one fraction and another: the larger, where both are opaque
float both_block(float one, float other) {
#if defined(TRANSLUCENT)
    return one + other - one * other;
#else
    return max(one, other);
#endif
}

// radius of a ball about the middle of a footprint that contains it
float footprint_radius(mat2x3 sides) {
    return 0.5 * (length(sides[0]) + length(sides[1]));
}

// width of a ray over the footprint's
float ray_grain(int count) {
    return min(RAY_WIDTH * inversesqrt(float(count)), 1.0);
}

// by how much a ray widens for a metre, over the radius of the disc at a metre
float ray_widening(int count) {
    return RAY_WIDTH * sqrt(PI / float(count));
}

// factors on the places of rays in the footprint and on their directions, such that rays of that width have the second
// moments of both together: a square's is 1/12 of its squared side, a disc's 1/4 of its squared radius
vec2 ray_places(int count) {
    float grain = ray_grain(count), widening = ray_widening(count);
    return sqrt(max(1.0 - vec2(grain * grain, widening * widening / 3.0), 0.0));
}

// number of the lowest set bit; 0 if there is none
int lowest_slot(int bits) {
    return bits == 0 ? 0 : int(log2(float(bits & -bits)) + 0.5);
}

// the disc of which a ball of `radius` metres about p sees all parts of a body: middle across the light, and radius;
// negative above the body
vec3 disc_across(Caster caster, vec3 p, float radius, vec2 middle, float spread) {
    float high = caster.reach.y - p.z + radius, low = max(caster.reach.x - p.z - radius, 0.0);
    float wide = radius + spread * high + 0.5 * length(middle) * (high - low);
    return vec3(p.xy + 0.5 * (low + high) * middle, high > 0.0 ? wide : -1.0);
}

// those of the bodies `listed` (bits) that may occlude part of the light's disc from part of a ball about p. middle:
// slope of the disc's centre, spread: tangent of its radius. gap: distance [m] to the nearest of them. umbra: whether
// one of them occludes all of the disc from all of the ball
int bodies_between(sampler2D sun_map, sampler2D casters, int listed, float slot_size, vec3 p, float radius,
                   vec2 middle, float spread, out float gap, out bool umbra) {
    int near = 0, between = 0;
    gap = 1e9;
    umbra = false;
    do {
        int lowest = listed & -listed;
        Caster caster = fetch_caster(casters, lowest_slot(listed));
        vec3 disc = disc_across(caster, p, radius, middle, spread);
        vec2 across = abs(disc.xy - caster.center) - caster.half_size;
        if (disc.z >= 0.0 && max(across.x, across.y) <= disc.z) near |= lowest;
        listed &= ~lowest;
    } while (listed != 0);
    // a filtered column is empty, or full, only if everything within a texel of that level is
    do {
        int lowest = near & -near;
        Caster caster = fetch_caster(casters, lowest_slot(near));
        vec3 disc = disc_across(caster, p, radius, middle, spread);
        float wide = disc.z * slot_size / min(caster.half_size.x, caster.half_size.y);
        float texels = max(2.0 * power_below(max(wide, 0.5)), 1.0);
        bool known = texels * SMALLEST <= slot_size;
        vec2 place = (disc.xy - caster.center) / caster.half_size * 0.5 + 0.5;
        vec4 column = sun_texel(sun_map, caster, slot_size, min(texels, slot_size / SMALLEST), place);
        float full = column.x;
#if defined(TRANSLUCENT)
        full = column.w;
#endif
        if (lowest != 0 && (column.x > 0.0 || !known)) {
            between |= lowest;
            float below = caster.reach.x - p.z - radius;
            gap = min(gap, max(below, 0.0));
            umbra = umbra || (known && below >= 0.0 && full > 0.9999 && place == clamp(place, 0.0, 1.0));
        }
        near &= ~lowest;
    } while (near != 0);
    return between;
}

// visible fraction of the sun's disc, a mean over a footprint about p, in the map's axes (two across, one along);
// undefined unless `wanted`, and free where a whole block of pixels does not want it. Where half of the rays agree that
// all of it is seen, or none, the others are not asked: one of every two, the first and the second in turn, as rays that
// follow each other lie in other columns of the footprint. listed: bits of the bodies that may occlude the disc. middle:
// slope of its centre.
// rays: slope over a unit disc, and place in [-0.5, 0.5]^2 of the footprint, of which each `every`-th is taken. spread:
// tangent of the disc's radius
float sun_visibility(sampler2D sun_map, sampler2D casters, int listed, float slot_size, vec3 p, mat2x3 sides,
                     vec2 middle, vec4 rays[MAXIMUM_SUN_RAYS], int count, int every, float spread, bool wanted) {
    float gap, blocked = 0.0, widening = spread * ray_widening(count);
    vec2 places = ray_places(count);
    float grain = ray_grain(count) * sqrt(abs(determinant(mat2(sides[0].xy, sides[1].xy))));
    bool umbra;
    int between = bodies_between(sun_map, casters, listed, slot_size, p, footprint_radius(sides), middle,
                                 spread, gap, umbra);
    int k = !wanted || between == 0 || umbra ? count : 0;
    int few = count < FEWEST_SUN_RAYS ? count : count / 2;
    bool agreed = false;
    do {
        int left = between, pair = k % few, second = (pair + k / few) % 2;
        int number = k < 2 * few && few < count ? 2 * pair + second : k;
        float most = 0.0;
        vec4 ray = rays[every * min(number, count - 1)];
        vec3 start = p + sides * (places.x * ray.zw);
        vec2 slope = middle + places.y * spread * ray.xy;
        do {
            int lowest = left & -left;
            Caster caster = fetch_caster(casters, lowest_slot(left));
            float one = sun_blocked(sun_map, caster, slot_size, start, slope, grain, widening);
            if (lowest != 0 && k < count) most = both_block(most, one);
            left &= ~lowest;
        } while (left != 0 && most < 1.0);
        blocked += most;
        ++k;
        agreed = k == few && (blocked <= 0.0 || blocked >= float(few));
    } while (k < count && !agreed);
    return umbra ? 0.0 : 1.0 - blocked / float(agreed ? few : count);
}
