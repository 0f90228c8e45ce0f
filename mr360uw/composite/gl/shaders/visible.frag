// First surface hit by each ray of a pixel, among the triangles listed for its block. Held to
// composite/raycast/pixel_samples.py. It writes
//   WHOLE: triangle + 1 at the centre if one smooth piece fills the pixel, 0 if nothing is hit, -1 otherwise
//   BY_SAMPLE: triangle + 1 of every ray
//   neither: groups of rays on one smooth piece, (triangle + 1 at the representative ray, bits of the rays in WORDS
//   numbers of WORD_BITS) each
#include "composite/gl/shaders/blocks.glsl"
#include "composite/gl/shaders/geometry.glsl"
#include "sphere.glsl"
#if defined(EYE)
uniform float eye_m;  // of the eye to the right of the middle, negative to the left
#endif
uniform sampler2D facet_a, facet_b, facet_c, lists, members, masks;
uniform vec2 frame_size;
uniform vec4 turns[4 * FOURS];
#if defined(PICKED)
uniform sampler2D picked;
#endif
#if defined(CUTOUTS) || defined(BLENDED)
uniform sampler2D more_lists;
#endif
#if defined(CUTOUTS)
uniform sampler2D cutout_a, cutout_b, cutout_c, cutout_maps, cutouts;
uniform vec4 beside[4];
uniform int ray_count;  // is 4 * FOURS: compilers write out no loop whose end they do not know
#endif
#if defined(BLENDED)
uniform int layer;
#endif
#if defined(WHOLE)
out float shown;
#elif defined(BY_SAMPLE)
layout(location = 0) out vec4 shown[FOURS];
#else
uniform vec2 cells[4 * FOURS];
const int ENTRY = 1 + WORDS;
layout(location = 0) out vec4 shown[GROUPS * ENTRY / 4];
#endif

// EACH_FOUR writes a line for every four rays: arrays with constant indices stay in registers
Four fours[FOURS];
vec2 longitude, latitude;

ivec2 facet_place(int triangle) {
    return ivec2(triangle & (FACET_COLUMNS - 1), triangle / FACET_COLUMNS);
}

// piece: number of the smooth piece. nearest: upper bound of one over the distance to this triangle and all after it
Facet fetch_facet(int triangle, out float piece, out float nearest) {
    ivec2 at = facet_place(triangle);
    vec4 a = texelFetch(facet_a, at, 0), b = texelFetch(facet_b, at, 0), c = texelFetch(facet_c, at, 0);
    piece = a.w;
    nearest = b.w;
    return Facet(a.xyz, b.xyz, c.xyz, c.w);
}

vec3 plane_of(Facet facet) {
    return facet.a + facet.b + facet.c;
}

// distance from a plane within which hits share one shading evaluation, as a fraction of the ray's length
float tolerance(vec3 plane, float nearness) {
    return PLANE_TOLERANCE * PIXEL_FILTER * PI / frame_size.y / nearness * length(plane);
}

#if defined(EYE)
// rays that start on the viewing circle: their start, over their distance, is added to their direction (types/frames.py). A hit's
// place over its distance is what a facet's vectors are multiplied with, as a direction is where rays start at the origin
Four over_distance(Four four, vec4 nearness) {
    Four hit = four;
    hit.x = four.x - eye_m * nearness * four.z;
    hit.z = four.z + eye_m * nearness * four.x;
    return hit;
}

// rays to where they meet a facet's plane; turned away from where they would meet its back, if it has only one side
Four towards(Four four, Facet facet) {
    vec3 plane = facet.a + facet.b + facet.c;
    vec4 room = 1.0 - eye_m * (plane.z * four.x - plane.x * four.z);
    room = sign(room) * max(abs(room), 1e-9);
    Four hit = over_distance(four, products(four, plane) / room);
    vec4 shown = step(0.0, -facet.side * room) * 2.0 - 1.0;
    hit.x *= shown;
    hit.y *= shown;
    hit.z *= shown;
    return hit;
}
#else
Four over_distance(Four four, vec4 nearness) { return four; }
Four towards(Four four, Facet facet) { return four; }
#endif

#if defined(BLENDED)
// one over the distance from which the hits of a ray count
vec4 limit[FOURS];
#define FREE(f) limit[f] = vec4(1e30);

vec4 before(vec4 hit, vec4 nearer) {
    return hit * step(hit, nearer);
}
#else
#define before(hit, nearer) hit
#endif

#if defined(CUTOUTS)
// bits of the rays for which a triangle is solid
const int SOLID_BITS = 32;
uint solid[(4 * FOURS + SOLID_BITS - 1) / SOLID_BITS];

vec4 of_solid(vec4 hit, int four) {
    uvec4 place = uvec4(0u, 1u, 2u, 3u) + uint(4 * four % SOLID_BITS);
    return hit * vec4((uvec4(solid[4 * four / SOLID_BITS]) >> place) & 1u);
}

void set_solid(uint bits) {
    for (int w = 0; w < solid.length(); ++w) solid[w] = bits;
}

void cut_out(int triangle, Facet facet) {
    ivec2 at = facet_place(triangle);
    vec4 a = texelFetch(cutout_a, at, 0), b = texelFetch(cutout_b, at, 0), c = texelFetch(cutout_c, at, 0);
    vec4 map = texelFetch(cutout_maps, list_place(max(int(c.z), 0)), 0);
    mat3x2 uv = mat3x2(a.xy, a.zw, b.xy);
    vec3 alphas = vec3(b.zw, c.x);
#if defined(WHOLE)
    float least = 0.5 * (1.0 + c.y);
#else
    float least = c.y;
#endif
    Four near = towards(four_rays(longitude, latitude, vec4[4](beside[0], beside[1], beside[2], beside[3])), facet);
    vec2 here = uv * barycentric(facet, vec3(near.x.x, near.y.x, near.z.x)).xyz;
    vec2 du = uv_change(facet, uv, here, vec3(near.x.y, near.y.y, near.z.y));
    vec2 dv = uv_change(facet, uv, here, vec3(near.x.z, near.y.z, near.z.z));
    set_solid(0u);
    for (int k = 0; k < ray_count; ++k) {
        vec4 turn = turns[k];
        Four hit = towards(four_rays(longitude, latitude, vec4[4](turn, turn, turn, turn)), facet);
        vec3 weights = clamp(barycentric(facet, vec3(hit.x.x, hit.y.x, hit.z.x)).xyz, 0.0, 1.0);
        float alpha = dot(weights, alphas);
        if (c.z >= 0.0) alpha *= texture_lookup(cutouts, map, uv * weights, du, dv).r;
        if (alpha >= least) solid[k / SOLID_BITS] |= 1u << uint(k % SOLID_BITS);
    }
}
#else
#define of_solid(hit, four) hit
#endif

#define HITS(f) before(of_solid(hits(towards(fours[f], facet), facet), f), limit[f])

#define AIM(f) fours[f] = four_rays(longitude, latitude, vec4[4](turns[4*f], turns[4*f + 1], turns[4*f + 2], turns[4*f + 3]));
#define MEET(f) keep(fours[f], HITS(f), float(triangle + 1), piece);
#define LEAST(f) farthest = min(farthest, fours[f].nearness);

float smallest(vec4 v) {
    return min(min(v.x, v.y), min(v.z, v.w));
}

#if defined(WHOLE)
// nearness at the corners of everything that reaches into the pixel: the piece that is visible so far, and all others
float current = -1.0;
vec4 same = vec4(0.0), others = vec4(0.0);
bool touched = false;

float largest(vec4 v) {
    return max(max(v.x, v.y), max(v.z, v.w));
}

void note_reach(Facet facet, float piece) {
    Four corner = towards(fours[1], facet);
    vec4 u = products(corner, facet.a), v = products(corner, facet.b), w = products(corner, facet.c);
    vec4 near = max(u + v + w, 0.0);
    bool reaches = min(largest(u), min(largest(v), largest(w))) >= 0.0;
    bool seen = any(greaterThan(HITS(0), fours[0].nearness)) || any(greaterThan(HITS(1), fours[1].nearness));
    if (piece != current && (seen || (reaches && current < 0.0))) {
        others = max(others, same);
        same = vec4(0.0);
        current = piece;
    }
    touched = touched || reaches;
    if (reaches && piece == current) same = max(same, near);
    if (reaches && piece != current) others = max(others, near);
}
#endif

// Intersects members [first, end), which are sorted by nearness: stops once all rays have hit something nearer than the
// rest can be. Loops test at their end, because software drivers execute a body once more to leave
void intersect_members(int first, int end, int pixel, bool cut) {
    int from = first & ~3;
    bool over = first >= end;
    if (!over) do {
        int wanted = members_of_pixel(masks, max(first, from), end, pixel);
        if (wanted != 0) do {
            int triangle = int(texelFetch(members, list_place(from + lowest_bit(wanted)), 0).r);
            wanted &= wanted - 1;
            float piece, nearest;
            Facet facet = fetch_facet(triangle, piece, nearest);
#if defined(CUTOUTS)
            if (cut) cut_out(triangle, facet);
#endif
#if defined(WHOLE)
            note_reach(facet, piece);
#endif
            EACH_FOUR(MEET)
            vec4 farthest = vec4(1e30);
            EACH_FOUR(LEAST)
            over = smallest(farthest) >= nearest;
        } while (wanted != 0 && !over);
        from += MEMBERS_AT_ONCE;
    } while (from < end && !over);
}

#if defined(BLENDED)
#define BEGIN(f) wall[f] = fours[f].nearness;
#define BACK(f) fours[f].nearness = wall[f]; fours[f].triangle = vec4(0.0);
#define PASS(f) limit[f] = pass(fours[f]);
#define LEAVE(f) fours[f].nearness *= min(fours[f].triangle, 1.0);

// one over the distance from which the next surface counts, just behind the last one
vec4 pass(Four four) {
    return min(four.triangle, 1.0) * four.nearness / (1.0 + 4e-6 + 1e-7 * four.nearness);
}
#endif

// Intersects the members of a block: opaque ones, then cut-outs, then blended surfaces in front of both, which are peeled
// one after the other. In rounds with a single call, because compilers write every call out
void intersect_all(int block, vec4 list, int pixel) {
#if defined(CUTOUTS) || defined(BLENDED)
    vec2 more = texelFetch(more_lists, list_place(block), 0).xy;
#if defined(CUTOUTS)
    set_solid(~0u);
#endif
#if defined(BLENDED)
    EACH_FOUR(FREE)
    vec4 wall[FOURS];
    int rounds = 3 + layer;
#else
    const int rounds = 2;
#endif
    int round = 0;
    do {
        int first = int(round == 0 ? list.z : round == 1 ? list.w : more.x);
        int end = int(round == 0 ? list.w : round == 1 ? more.x : more.y);
#if defined(BLENDED)
        if (round == 2) {
#if defined(CUTOUTS)
            set_solid(~0u);
#endif
            EACH_FOUR(BEGIN)
        }
        if (round >= 2) {
            EACH_FOUR(BACK)
        }
#endif
        intersect_members(first, end, pixel, round == 1);
#if defined(BLENDED)
        if (round >= 2) {
            EACH_FOUR(PASS)
        }
#endif
    } while (++round < rounds);
#if defined(BLENDED)
    EACH_FOUR(LEAVE)
#endif
#else
    intersect_members(int(list.z), int(list.w), pixel, false);
#endif
}

#if defined(WHOLE)
// tolerances in front of a piece from which on a surface of the same piece is another part of it
const float APART = 4.0;

bool all_near(Four four, vec3 plane, float slack, float piece) {
    vec4 off = abs(products(over_distance(four, four.nearness), plane) / four.nearness - 1.0);
    return all(equal(four.piece, vec4(piece))) && all(greaterThan(four.nearness, vec4(0.0)))
        && all(lessThanEqual(off, vec4(slack)));
}

void write_result() {
    float center = fours[0].triangle.x, piece, nearest;
    Facet facet = fetch_facet(max(int(center) - 1, 0), piece, nearest);
    vec3 plane = plane_of(facet);
    float slack = tolerance(plane, fours[0].nearness.x);
    vec4 corners = products(towards(fours[1], facet), plane);
    bool whole = center > 0.0 && piece == current
        && all_near(fours[0], plane, slack, piece) && all_near(fours[1], plane, slack, piece)
        && all(lessThanEqual(same * (1.0 - APART * slack), corners)) && all(lessThanEqual(others, corners));
    shown = whole ? center : touched ? -1.0 : 0.0;
}
#elif defined(BY_SAMPLE)
#define SHOW(f) shown[f] = fours[f].triangle;
void write_result() {
    EACH_FOUR(SHOW)
}
#else
struct Group {
    float triangle, nearness, piece;
    int rank;
    vec3 plane;
    float slack;
    bool last;
    float rays;
    vec2 sum;
    float closest;
};

// the first ray without a group
void find_seed(Four four, inout Group group, int first) {
    for (int k = 3; k >= 0; --k) {
        bool left = four.nearness[k] > 0.0;
        group.triangle = left ? four.triangle[k] : group.triangle;
        group.nearness = left ? four.nearness[k] : group.nearness;
        group.piece = left ? four.piece[k] : group.piece;
        group.rank = left ? first + k : group.rank;
    }
}

// adds rays to a group and returns their bits; until it is complete they are marked by a negative nearness
float gather(inout Four four, inout Group group, int first) {
    float bits = 0.0;
    vec4 off = abs(products(over_distance(four, four.nearness), group.plane) / four.nearness - 1.0);
    for (int k = 0; k < 4; ++k) {
        bool near = four.piece[k] == group.piece && off[k] <= group.slack;
        bool taken = four.nearness[k] > 0.0 && (near || group.last || first + k == group.rank);
        group.rays += taken ? 1.0 : 0.0;
        bits += taken ? float(1 << (first + k) % WORD_BITS) : 0.0;
        group.sum += taken ? cells[first + k] : vec2(0.0);
        four.nearness[k] = taken ? -1.0 : four.nearness[k];
    }
    return bits;
}

// the ray closest to the mean of a group represents it
void represent(inout Four four, inout Group group, int first) {
    for (int k = 0; k < 4; ++k) {
        vec2 away = group.rays * cells[first + k] - group.sum;
        bool closer = four.nearness[k] < 0.0 && dot(away, away) < group.closest;
        group.closest = closer ? dot(away, away) : group.closest;
        group.rank = closer ? first + k : group.rank;
        group.triangle = closer ? four.triangle[k] : group.triangle;
        four.nearness[k] = max(four.nearness[k], 0.0);
    }
}

#define SEED(f) find_seed(fours[FOURS - 1 - f], group, 4 * (FOURS - 1 - f));
// a word holds the bits of whole fours, so that those which fill up the last four have a place too
#define GATHER(f) of_group[4 * f / WORD_BITS] += gather(fours[f], group, 4 * f);
#define REPRESENT(f) represent(fours[f], group, 4 * f);

const Group NONE = Group(0.0, 0.0, 0.0, -1, vec3(0.0), 0.0, false, 0.0, vec2(0.0), 1e9);

void write_result() {
    fours[FOURS - 1].nearness *= LAST;
    float found[GROUPS * ENTRY];
    for (int k = 0; k < GROUPS * ENTRY; ++k) found[k] = 0.0;
    int number = 0;
    Group group = NONE;
    EACH_FOUR(SEED)
    if (group.rank >= 0) do {
        float piece, nearest;
        group.plane = plane_of(fetch_facet(int(group.triangle) - 1, piece, nearest));
        group.slack = tolerance(group.plane, group.nearness);
        group.last = number == GROUPS - 1;
        float of_group[WORDS];
        for (int w = 0; w < WORDS; ++w) of_group[w] = 0.0;
        EACH_FOUR(GATHER)
        EACH_FOUR(REPRESENT)
        for (int k = 0; k < GROUPS; ++k) {
            if (number != k) continue;
            found[ENTRY * k] = group.triangle;
            for (int w = 0; w < WORDS; ++w) found[ENTRY * k + 1 + w] = of_group[w];
        }
        ++number;
        group = NONE;
        EACH_FOUR(SEED)
    } while (group.rank >= 0);
    for (int k = 0; k < GROUPS * ENTRY / 4; ++k)
        shown[k] = vec4(found[4 * k], found[4 * k + 1], found[4 * k + 2], found[4 * k + 3]);
}
#endif

void main() {
    int lane = lane_number(ivec2(gl_FragCoord.xy));
#if defined(PICKED)
    vec2 pick = texelFetch(picked, list_place(lane), 0).xy;
    int block = int(pick.x), pixel = int(pick.y);
#else
    int block = lane >> 4, pixel = lane & 15;
#endif
    vec4 list = texelFetch(lists, list_place(block), 0);
    vec2 corner = list.xy + vec2(place_in_block(pixel));
    float lon = 2.0 * PI * (corner.x / frame_size.x - 0.5), lat = PI * (0.5 - corner.y / frame_size.y);
    longitude = vec2(cos(lon), sin(lon));
    latitude = vec2(cos(lat), sin(lat));
    EACH_FOUR(AIM)
    intersect_all(block, list, pixel);
    write_result();
}
