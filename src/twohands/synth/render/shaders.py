"""GLSL of the raster renderer."""

from __future__ import annotations

from typing import Final

from twohands.synth.body import BONE_NAMES

MAX_LIGHTS: Final = 8
MAX_CAPSULES: Final = 40

_SKINNING: Final = f"""
#version 330
uniform vec4 bones[{3 * (len(BONE_NAMES) + 1)}];  // three rows of every transform, the resting torso last
uniform mat4 projection;
in vec3 position;
in vec3 normal;
in vec4 bones_a, bones_b, weights_a, weights_b;
in vec4 surface;  // resting weight, part label, palm side, flush
in vec3 nail;
in float along;  // from the wrist (0) to the elbow (1)
uniform float sleeve_from, glove_until, thickness;
out vec3 camera_position;
out vec3 camera_normal;
out vec3 rest_position;
out vec2 look;  // palm side, flush
out vec3 nail_position;
out float on_arm;
flat out float label;

void blend(inout vec4 rows[3], int bone, float weight) {{
    for (int r = 0; r < 3; ++r) rows[r] += weight * bones[3 * bone + r];
}}

void skin() {{
    vec4 rows[3] = vec4[3](vec4(0.0), vec4(0.0), vec4(0.0));
    for (int i = 0; i < 4; ++i) {{
        if (weights_a[i] > 0.0) blend(rows, int(bones_a[i]), weights_a[i]);
        if (weights_b[i] > 0.0) blend(rows, int(bones_b[i]), weights_b[i]);
    }}
    if (surface.x > 0.0) blend(rows, {len(BONE_NAMES)}, surface.x);
    float covered = max(smoothstep(0.0, 0.03, along - sleeve_from),
                        0.3 * (1.0 - smoothstep(-0.03, 0.0, along - glove_until)));
    vec4 p = vec4(position + thickness * covered * normal, 1.0);
    on_arm = along;
    camera_position = vec3(dot(rows[0], p), dot(rows[1], p), dot(rows[2], p));
    camera_normal = vec3(dot(rows[0].xyz, normal), dot(rows[1].xyz, normal), dot(rows[2].xyz, normal));
    rest_position = position;
    look = surface.zw;
    nail_position = nail;
    label = surface.y;
    gl_Position = projection * vec4(camera_position, 1.0);
}}
"""

LABEL_VERTEX: Final = f"{_SKINNING}void main() {{ skin(); }}"

COLOUR_VERTEX: Final = f"""{_SKINNING}
uniform vec4 capsule_from[{MAX_CAPSULES}], capsule_to[{MAX_CAPSULES}];  // the hands' bones: end, and radius in w
uniform int capsule_count;
uniform vec3 light_position[{MAX_LIGHTS}];
uniform int light_count;
out float openness;  // share of the sky that other parts of the hands leave free
out vec4 shadow_a, shadow_b;  // share of each light that reaches this point

// Distance between the ray p + t l, t > 0, and the segment a b.
float ray_distance(vec3 p, vec3 l, vec3 a, vec3 b, out float t) {{
    vec3 u = b - a, w = p - a;
    float uu = dot(u, u), ul = dot(u, l), uw = dot(u, w), lw = dot(l, w);
    float s = clamp((uw - ul * lw) / max(uu - ul * ul, 1e-9), 0.0, 1.0);
    t = max(s * ul - lw, 0.0);
    return length(w + t * l - s * u);
}}

void main() {{
    skin();
    vec3 n = normalize(camera_normal);
    float hidden = 0.0;
    float lit[{MAX_LIGHTS}];
    for (int k = 0; k < {MAX_LIGHTS}; ++k) lit[k] = 1.0;
    for (int i = 0; i < capsule_count; ++i) {{
        vec3 a = capsule_from[i].xyz, b = capsule_to[i].xyz;
        float r = capsule_from[i].w;
        float s = clamp(dot(camera_position - a, b - a) / max(dot(b - a, b - a), 1e-9), 0.0, 1.0);
        vec3 d = mix(a, b, s) - camera_position;
        float distance = length(d);
        float solid = min(r * r / (distance * distance), 1.0);
        hidden += max(dot(n, d / distance), 0.0) * solid;
        if (distance < 1.35 * r) continue;  // its own bone
        for (int k = 0; k < light_count; ++k) {{
            vec3 l = normalize(light_position[k] - camera_position);
            float t;
            float miss = ray_distance(camera_position, l, a, b, t);
            float blur = 0.35 * r + 0.12 * t;  // lamps are not points
            lit[k] *= t > 0.0 ? smoothstep(r - blur, r + blur, miss) : 1.0;
        }}
    }}
    openness = 1.0 / (1.0 + 1.3 * hidden);
    shadow_a = vec4(lit[0], lit[1], lit[2], lit[3]);
    shadow_b = vec4(lit[4], lit[5], lit[6], lit[7]);
}}
"""

LABEL_FRAGMENT: Final = """
#version 330
in vec3 camera_position;
flat in float label;
out vec2 plane;

void main() {
    plane = vec2(label, camera_position.z);
}
"""

COLOUR_FRAGMENT: Final = f"""
#version 330
uniform vec3 light_position[{MAX_LIGHTS}];
uniform vec3 light_colour[{MAX_LIGHTS}];
uniform vec3 sky, ground, albedo, palm_albedo, nail_albedo, noise_offset;
uniform vec3 sleeve_albedo, glove_albedo, pattern;
uniform float roughness, mottle, sleeve_from, glove_until;
uniform int light_count;
in float on_arm;
in vec3 camera_position;
in vec3 camera_normal;
in vec3 rest_position;
in vec2 look;
in vec3 nail_position;
in float openness;
in vec4 shadow_a, shadow_b;
out vec4 colour;

float hash(vec3 p) {{
    p = fract(p * 0.3183099 + 0.1);
    p *= 17.0;
    return fract(p.x * p.y * p.z * (p.x + p.y + p.z));
}}

float noise(vec3 x) {{
    vec3 i = floor(x), f = fract(x);
    f = f * f * (3.0 - 2.0 * f);
    return mix(mix(mix(hash(i), hash(i + vec3(1, 0, 0)), f.x),
                   mix(hash(i + vec3(0, 1, 0)), hash(i + vec3(1, 1, 0)), f.x), f.y),
               mix(mix(hash(i + vec3(0, 0, 1)), hash(i + vec3(1, 0, 1)), f.x),
                   mix(hash(i + vec3(0, 1, 1)), hash(i + vec3(1, 1, 1)), f.x), f.y), f.z);
}}

void main() {{
    vec3 n = normalize(camera_normal);
    vec3 v = normalize(-camera_position);
    if (dot(n, v) < 0.0) n = normalize(n - 1.05 * dot(n, v) * v);

    vec3 q = rest_position + noise_offset;
    float blotch = noise(q * 45.0) - 0.5;
    float grain = noise(q * 330.0) - 0.5;
    float fine = noise(q * 900.0) - 0.5;
    vec3 base = mix(albedo, palm_albedo, look.x);
    base *= 1.0 + mottle * (0.35 * blotch + 0.28 * grain + 0.18 * fine);
    base *= mix(vec3(1.0), vec3(1.06, 0.86, 0.84), look.y * 0.8 + mottle * 0.5 * blotch);
    float gloss = roughness;
    float on_nail = smoothstep(0.38, 0.46, nail_position.x) * (1.0 - smoothstep(0.97, 1.0, nail_position.x))
                  * (1.0 - smoothstep(0.5, 0.66, abs(nail_position.y))) * smoothstep(0.25, 0.5, nail_position.z);
    float free_edge = smoothstep(0.88, 0.93, nail_position.x);
    base = mix(base, mix(nail_albedo, vec3(0.8, 0.74, 0.66), free_edge * 0.7), on_nail * 0.85);
    gloss = mix(gloss, 0.22, on_nail);

    bool sleeve = on_arm > sleeve_from, glove = on_arm < glove_until;
    if (sleeve || glove) {{
        float across = rest_position.x * cos(pattern.z) + rest_position.y * sin(pattern.z);
        float stripe = sin(6.2831853 / pattern.y * across);
        float weave = 0.10 * grain + 0.16 * fine + 0.25 * blotch;
        base = sleeve ? sleeve_albedo * (1.0 - pattern.x * smoothstep(-0.1, 0.1, stripe)) : glove_albedo;
        base *= 1.0 + weave;
        if (sleeve) base *= 0.72 + 0.28 * smoothstep(0.0, 0.012, on_arm - sleeve_from);  // the hem
        gloss = 0.85;
    }}
    float up = 0.5 - 0.5 * n.y;
    // Light between fingers has bounced off skin, so that creases are warm, not grey.
    vec3 lit = base * mix(ground, sky, up) * mix(pow(vec3(openness), 1.0 - 0.6 * base), vec3(1.0), openness);
    float exponent = 2.0 / pow(gloss, 4.0);
    for (int i = 0; i < light_count; ++i) {{
        vec3 to_light = light_position[i] - camera_position;
        float d2 = dot(to_light, to_light);
        vec3 l = to_light * inversesqrt(d2);
        float cosine = dot(n, l);
        // Light bleeds around the edge of skin, red farthest.
        vec3 wrap = vec3(0.28, 0.14, 0.09);
        vec3 diffuse = max((vec3(cosine) + wrap) / ((1.0 + wrap) * (1.0 + wrap)), 0.0);
        vec3 h = normalize(l + v);
        float shine = pow(max(dot(n, h), 0.0), exponent) * (exponent + 8.0) / 26.0;
        float fresnel = 0.028 + 0.5 * pow(1.0 - max(dot(h, v), 0.0), 5.0);
        float reaches = i < 4 ? shadow_a[i] : shadow_b[i - 4];
        lit += reaches * light_colour[i] / d2 * (base * diffuse + shine * fresnel * max(cosine, 0.0));
    }}
    vec3 mapped = lit / (1.0 + 0.25 * lit);
    colour = vec4(pow(clamp(mapped, 0.0, 1.0), vec3(1.0 / 2.2)), 1.0);
}}
"""
