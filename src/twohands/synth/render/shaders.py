"""GLSL of the raster renderer: vertices are posed and shaded once, then drawn twice."""

from __future__ import annotations

from typing import Final

from twohands.synth.scene.body import BONE_NAMES

MAX_LIGHTS: Final = 4
MAX_CAPSULES: Final = 42
"""Twenty for each hand, and what each may hold."""

POSED: Final = ("camera_position", "camera_normal", "irradiance", "shadow", "mottling")
"""What `POSE_VERTEX` captures, in this order: 3, 3, 3, 4 and 1 floats a vertex."""

NOISE: Final = """
float hash(vec3 p) {
    p = fract(p * 0.3183099 + 0.1);
    p *= 17.0;
    return fract(p.x * p.y * p.z * (p.x + p.y + p.z));
}

float noise(vec3 x) {
    vec3 i = floor(x), f = fract(x);
    f = f * f * (3.0 - 2.0 * f);
    return mix(mix(mix(hash(i), hash(i + vec3(1, 0, 0)), f.x),
                   mix(hash(i + vec3(0, 1, 0)), hash(i + vec3(1, 1, 0)), f.x), f.y),
               mix(mix(hash(i + vec3(0, 0, 1)), hash(i + vec3(1, 0, 1)), f.x),
                   mix(hash(i + vec3(0, 1, 1)), hash(i + vec3(1, 1, 1)), f.x), f.y), f.z);
}
"""

GRAIN: Final = """
// Fine texture, about -0.5 to 0.5, for less than half the price of `noise`: triangle waves, bent twice.
float grains(vec3 x) {
    x += 3.1 * abs(fract(x.yzx * 0.171) - 0.5);
    x += 2.3 * abs(fract(x.zxy * 0.431 + 0.3) - 0.5);
    vec3 phase = mat3(0.33, -0.27, 0.24, 0.29, 0.36, -0.19, -0.21, 0.25, 0.41) * x;
    return 0.6 * dot(abs(fract(phase) - 0.5), vec3(1.0)) - 0.45;
}
"""

TONE: Final = """
vec4 tone(vec3 lit) {  // sRGB's curve within 2 levels, 6 in the deepest shadows, by a root: a power would cost more
    vec3 root = sqrt(clamp(lit / (1.0 + 0.25 * lit), 0.0, 1.0));
    return vec4(root * (1.1386 - 0.1386 * root), 1.0);
}

// Highlight: Blinn-Phong's lobe, its power replaced by the Gaussian that it tends to.
float shine(vec3 n, vec3 l, vec3 v, float roughness) {
    float exponent = 2.0 / (roughness * roughness * roughness * roughness);
    vec3 h = normalize(l + v);
    float lobe = exp2(1.442695 * exponent * (max(dot(n, h), 0.0) - 1.0)) * (exponent + 8.0) / 26.0;
    float graze = 1.0 - max(dot(h, v), 0.0);
    return lobe * (0.028 + 0.5 * graze * graze * graze * graze * graze) * max(dot(n, l), 0.0);
}
"""

POSE_VERTEX: Final = f"""
#version 330
uniform vec4 bones[{3 * (len(BONE_NAMES) + 1)}];  // three rows of every transform, the resting torso last
uniform float sleeve_from, glove_until, thickness;
uniform vec4 capsule_from[{MAX_CAPSULES}];  // the hands' bones, then what they hold: one end, and the radius
uniform vec4 capsule_along[{MAX_CAPSULES}];  // to the other end, and 1 / length^2
uniform int capsule_count, bone_count;
uniform int light_count;
uniform vec3 light_position[{MAX_LIGHTS}];
uniform vec3 light_colour[{MAX_LIGHTS}];
uniform vec3 sky, ground, albedo, sleeve_albedo, noise_offset;
in vec3 position;
in vec3 normal;
in vec4 bones_a, bones_b, weights_a, weights_b;
in float resting;  // weight of the torso
in float along;  // from the wrist (0) to the elbow (1)
out vec3 camera_position;
out vec3 camera_normal;
out vec3 irradiance;  // diffuse light of sky and lamps
out vec4 shadow;  // share of each light that reaches this point
out float mottling;  // coarse changes of the skin's colour

{NOISE}

void blend(inout vec4 rows[3], int bone, float weight) {{
    for (int r = 0; r < 3; ++r) rows[r] += weight * bones[3 * bone + r];
}}

// Share of a lamp in direction l that a capsule leaves at the distance w from its first end.
float passes(vec3 w, float uw, vec3 l, vec3 u, float u2, float radius) {{
    float ul = dot(u, l), lw = dot(l, w);
    float s = clamp((uw - ul * lw) / max(u2 - ul * ul, 1e-9), 0.0, 1.0);
    float t = s * ul - lw;
    vec3 miss = w + t * l - s * u;
    float blur = 0.35 * radius + 0.12 * t;  // lamps are not points
    float low = max(radius - blur, 0.0), high = radius + blur;
    return t > 0.0 ? smoothstep(low * low, high * high, dot(miss, miss)) : 1.0;
}}

void main() {{
    vec4 rows[3] = vec4[3](vec4(0.0), vec4(0.0), vec4(0.0));
    for (int i = 0; i < 4; ++i) {{
        if (weights_a[i] > 0.0) blend(rows, int(bones_a[i]), weights_a[i]);
        if (weights_b[i] > 0.0) blend(rows, int(bones_b[i]), weights_b[i]);
    }}
    if (resting > 0.0) blend(rows, {len(BONE_NAMES)}, resting);
    float covered = max(smoothstep(0.0, 0.03, along - sleeve_from),
                        0.3 * (1.0 - smoothstep(-0.03, 0.0, along - glove_until)));
    vec4 rest = vec4(position + thickness * covered * normal, 1.0);
    vec3 p = vec3(dot(rows[0], rest), dot(rows[1], rest), dot(rows[2], rest));
    vec3 n = normalize(vec3(dot(rows[0].xyz, normal), dot(rows[1].xyz, normal), dot(rows[2].xyz, normal)));

    vec3 l0 = normalize(light_position[0] - p), l1 = normalize(light_position[1] - p);
    vec3 l2 = normalize(light_position[2] - p), l3 = normalize(light_position[3] - p);
    vec4 lit = vec4(1.0);
    float hidden = 0.0;
    for (int i = 0; i < capsule_count; ++i) {{
        vec3 u = capsule_along[i].xyz, w = p - capsule_from[i].xyz;
        float radius = capsule_from[i].w, r2 = radius * radius, uw = dot(u, w);
        vec3 d = clamp(uw * capsule_along[i].w, 0.0, 1.0) * u - w;
        float d2 = dot(d, d), near = inversesqrt(d2);
        hidden += max(dot(n, d) * near, 0.0) * min(r2 * near * near, 1.0);
        if (i >= bone_count || d2 > 1.8 * r2) {{  // not its own bone
            float u2 = dot(u, u);
            lit *= vec4(passes(w, uw, l0, u, u2, radius), passes(w, uw, l1, u, u2, radius),
                        passes(w, uw, l2, u, u2, radius), passes(w, uw, l3, u, u2, radius));
        }}
    }}
    camera_position = p;
    camera_normal = n;
    shadow = lit;
    mottling = noise((position + noise_offset) * 45.0) - 0.5;
    // Light between fingers has bounced off skin, so that creases are warm, not grey.
    float open = 1.0 / (1.0 + 1.3 * hidden);
    vec3 around = along > sleeve_from ? sleeve_albedo : albedo;
    irradiance = mix(ground, sky, 0.5 - 0.5 * n.y) * mix(pow(vec3(open), 1.0 - 0.6 * around), vec3(1.0), open);
    for (int i = 0; i < light_count; ++i) {{
        vec3 to_light = light_position[i] - p;
        float d2 = dot(to_light, to_light);
        vec3 wrap = vec3(0.28, 0.14, 0.09);  // light bleeds around the edge of skin, red farthest
        vec3 diffuse = max((dot(n, to_light) * inversesqrt(d2) + wrap) / ((1.0 + wrap) * (1.0 + wrap)), 0.0);
        irradiance += lit[i] / d2 * light_colour[i] * diffuse;
    }}
}}
"""

LABEL_VERTEX: Final = """
#version 330
uniform mat4 projection;
in vec3 camera_position;
in float part;
flat out float label;
out float depth;

void main() {
    label = part;
    depth = camera_position.z;
    gl_Position = projection * vec4(camera_position, 1.0);
}
"""

LABEL_FRAGMENT: Final = """
#version 330
flat in float label;
in float depth;
layout(location = 0) out float part;
layout(location = 1) out float z;

void main() {
    part = label / 255.0;
    z = depth;
}
"""

_COLOUR_VERTEX: Final = """
uniform mat4 projection;
in vec3 camera_position;
in vec3 camera_normal;
in vec3 irradiance;
in vec4 shadow;
in float mottling;
in vec3 position;
in vec2 look;  // palm side, flush
in vec3 nail;
in float along;
out vec3 point;
out vec3 facing;
out vec3 received;
out vec4 reached;
out vec3 rest_position;
out vec2 skin;
out vec3 nail_position;
out float on_arm;
out float blotch;
#ifdef CHART
in vec3 chart;
out vec3 on_chart;
#endif

void main() {
#ifdef CHART
    on_chart = chart;
#endif
    point = camera_position;
    facing = camera_normal;
    received = irradiance;
    reached = shadow;
    rest_position = position;
    skin = look;
    nail_position = nail;
    on_arm = along;
    blotch = mottling;
    gl_Position = projection * vec4(camera_position, 1.0);
}
"""

THING_VERTEX: Final = """
#version 330
uniform mat4 projection;
in vec3 position;
in vec3 normal;
in vec3 albedo;
in float roughness, part;
out vec3 point;
out vec3 facing;
out vec3 base;
out float gloss;
flat out float label;
out float depth;

void main() {
    point = position;
    facing = normal;
    base = albedo;
    gloss = roughness;
    label = part;
    depth = position.z;
    gl_Position = projection * vec4(position, 1.0);
}
"""

THING_FRAGMENT: Final = f"""
#version 330
uniform vec3 light_position[{MAX_LIGHTS}];
uniform vec3 light_colour[{MAX_LIGHTS}];
uniform int light_count;
uniform vec3 sky, ground;
in vec3 point;
in vec3 facing;
in vec3 base;
in float gloss;
out vec4 colour;

{TONE}

void main() {{
    vec3 n = normalize(facing);
    vec3 v = normalize(-point);
    vec3 lit = base * mix(ground, sky, 0.5 - 0.5 * n.y);
    for (int i = 0; i < light_count; ++i) {{
        vec3 to_light = light_position[i] - point;
        float d2 = dot(to_light, to_light);
        vec3 l = to_light * inversesqrt(d2);
        lit += light_colour[i] / d2 * (base * max(dot(n, l), 0.0) + shine(n, l, v, gloss));
    }}
    colour = tone(lit);
}}
"""

_DETAIL: Final = """
uniform sampler2DArray markings;
uniform vec4 detail;  // strength of veins, creases, freckles, moles

// The normal of a surface raised by `height` metres. Source: Mikkelsen 2010, bump mapping unparametrized surfaces.
vec3 raised(vec3 n, float height) {
    vec3 across = dFdx(point), down = dFdy(point);
    vec3 a = cross(down, n), b = cross(n, across);
    float area = dot(across, a);
    return normalize(area * n - dFdx(height) * a - dFdy(height) * b) * sign(area);
}

// How far a vein stands out here, how deep a crease is, how dark freckles and moles are.
vec4 marked() {
    vec4 here = texture(markings, vec3(on_chart.xy, step(0.0, on_chart.z)));
    return here * detail * clamp(2.5 * abs(on_chart.z) - 0.25, 0.0, 1.0);
}
"""

_COLOUR_FRAGMENT: Final = f"""
uniform vec3 light_position[{MAX_LIGHTS}];
uniform vec3 light_colour[{MAX_LIGHTS}];
uniform vec3 albedo, palm_albedo, nail_albedo, noise_offset;
uniform vec3 sleeve_albedo, glove_albedo, pattern;
uniform float roughness, mottle, sleeve_from, glove_until;
uniform int light_count;
in vec3 point;
in vec3 facing;
in vec3 received;
in vec4 reached;
in vec3 rest_position;
in vec2 skin;  // palm side, flush
in vec3 nail_position;
in float on_arm;
in float blotch;
out vec4 colour;

{GRAIN}
{TONE}
#ifdef CHART
in vec3 on_chart;  // place on the markings, 0..1, and how squarely the skin faces its sheet
#endif
#ifdef DETAIL
{_DETAIL}
#endif
#ifdef FABRIC
uniform sampler2D tile;
uniform mat2 weave;  // from the place on the markings to that on the tile, once round at 1
uniform vec3 mean;  // colour of the tile
#endif

void main() {{
    vec3 n = normalize(facing);
    vec3 v = normalize(-point);
    float towards = dot(n, v);
    if (towards < 0.0) n = normalize(n - 1.05 * towards * v);

    float grain = grains((rest_position + noise_offset) * 700.0 + blotch * vec3(9.0, -7.0, 8.0));
    vec3 base = mix(albedo, palm_albedo, skin.x);
    base *= 1.0 + mottle * (0.35 * blotch + 0.4 * grain);
    base *= mix(vec3(1.0), vec3(1.06, 0.86, 0.84), skin.y * 0.8 + mottle * 0.5 * blotch);
    float gloss = roughness;
    float on_nail = smoothstep(0.38, 0.46, nail_position.x) * (1.0 - smoothstep(0.97, 1.0, nail_position.x))
                  * (1.0 - smoothstep(0.5, 0.66, abs(nail_position.y))) * smoothstep(0.25, 0.5, nail_position.z);
    float free_edge = smoothstep(0.88, 0.93, nail_position.x);
    base = mix(base, mix(nail_albedo, vec3(0.8, 0.74, 0.66), free_edge * 0.7), on_nail * 0.85);
    gloss = mix(gloss, 0.22, on_nail);

    bool sleeve = on_arm > sleeve_from, glove = on_arm < glove_until;
#ifdef DETAIL
    vec4 mark = marked();
    base = mix(base, min(base, albedo), 0.45 * mark.y);  // lines of a pale palm have the colour of the back
    base *= (1.0 - mark.x * vec3(0.20, 0.07, 0.03)) * (1.0 - mark.y * vec3(0.20, 0.32, 0.34))
          * (1.0 - mark.z * vec3(0.25, 0.40, 0.50)) * (1.0 - mark.w * vec3(0.60, 0.72, 0.78));
    vec3 smooth_n = n;
    if (!(sleeve || glove)) n = raised(n, 0.0010 * mark.x - 0.0005 * mark.y);
    vec3 bend = n - smooth_n;
#endif
    if (sleeve || glove) {{
        float across = rest_position.x * cos(pattern.z) + rest_position.y * sin(pattern.z);
        float stripe = sin(6.2831853 / pattern.y * across);
        base = sleeve ? sleeve_albedo * (1.0 - pattern.x * smoothstep(-0.1, 0.1, stripe)) : glove_albedo;
#ifdef FABRIC
        vec3 thread = texture(tile, weave * on_chart.xy).rgb;
        base *= thread * thread / mean;
#else
        base *= 1.0 + 0.24 * grain + 0.25 * blotch;
#endif
        if (sleeve) base *= 0.72 + 0.28 * smoothstep(0.0, 0.012, on_arm - sleeve_from);  // the hem
        gloss = 0.85;
    }}
    vec3 lit = base * received;
    for (int i = 0; i < light_count; ++i) {{
        vec3 to_light = light_position[i] - point;
        float d2 = dot(to_light, to_light);
        vec3 l = to_light * inversesqrt(d2);
        vec3 seen = vec3(shine(n, l, v, gloss));
#ifdef DETAIL
        seen += base * dot(bend, l);
#endif
        lit += reached[i] / d2 * light_colour[i] * seen;
    }}
    colour = tone(lit);
}}
"""


def colour_shaders(*, detailed: bool, woven: bool) -> tuple[str, str]:
    """Vertex and fragment shader of the picture, with veins and creases or without, with a fabric or without."""
    parts = {"DETAIL": detailed, "FABRIC": woven, "CHART": detailed or woven}
    head = "#version 330\n" + "".join(f"#define {part}\n" for part, wanted in parts.items() if wanted)
    return head + _COLOUR_VERTEX, head + _COLOUR_FRAGMENT
