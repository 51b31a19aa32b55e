"""GLSL of the raster renderer."""

from __future__ import annotations

from typing import Final

from twohands.synth.body import BONE_NAMES

MAX_LIGHTS: Final = 8

VERTEX: Final = f"""
#version 330
uniform vec4 bones[{3 * (len(BONE_NAMES) + 1)}];  // three rows of every transform, the resting torso last
uniform mat4 projection;
in vec3 position;
in vec3 normal;
in vec4 bones_a, bones_b, weights_a, weights_b;
in vec4 surface;  // resting weight, part label, palm side, flush
in vec3 nail;
out vec3 camera_position;
out vec3 camera_normal;
out vec3 rest_position;
out vec2 look;  // palm side, flush
out vec3 nail_position;
flat out float label;

void blend(inout vec4 rows[3], int bone, float weight) {{
    for (int r = 0; r < 3; ++r) rows[r] += weight * bones[3 * bone + r];
}}

void main() {{
    vec4 rows[3] = vec4[3](vec4(0.0), vec4(0.0), vec4(0.0));
    for (int i = 0; i < 4; ++i) {{
        if (weights_a[i] > 0.0) blend(rows, int(bones_a[i]), weights_a[i]);
        if (weights_b[i] > 0.0) blend(rows, int(bones_b[i]), weights_b[i]);
    }}
    if (surface.x > 0.0) blend(rows, {len(BONE_NAMES)}, surface.x);
    vec4 p = vec4(position, 1.0);
    camera_position = vec3(dot(rows[0], p), dot(rows[1], p), dot(rows[2], p));
    camera_normal = vec3(dot(rows[0].xyz, normal), dot(rows[1].xyz, normal), dot(rows[2].xyz, normal));
    rest_position = position;
    look = surface.zw;
    nail_position = nail;
    label = surface.y;
    gl_Position = projection * vec4(camera_position, 1.0);
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
uniform float roughness, mottle;
uniform int light_count;
in vec3 camera_position;
in vec3 camera_normal;
in vec3 rest_position;
in vec2 look;
in vec3 nail_position;
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

    float up = 0.5 - 0.5 * n.y;
    vec3 lit = base * mix(ground, sky, up);
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
        lit += light_colour[i] / d2 * (base * diffuse + shine * fresnel * max(cosine, 0.0));
    }}
    vec3 mapped = lit / (1.0 + 0.25 * lit);
    colour = vec4(pow(clamp(mapped, 0.0, 1.0), vec3(1.0 / 2.2)), 1.0);
}}
"""
