"""What are viser's shaders told beside? Points give way to the surfaces that they lie on, and labels know the dark.

A scan's points lie on the very surfaces that the estimate is drawn on, and noise has every other one before them:
points are drawn as if they were a share of their distance farther away, and a surface that fits them is whole. It moves
nothing in the picture: of a point only the depth changes that surfaces are compared with. Labels are black on white in
viser whatever the scheme; here each frame asks which one it is. A share by which points are `smaller` is for
`client_page`.
"""

from __future__ import annotations

import json

from pmpnbp.pictures.palette import rgb

# Of labels in the dark, as static/style.css has them: --well and --ink.
PLATE, LETTERS = "#232a33", "#e8ebef"


def _glsl(colour: str) -> str:
    """A colour, hexadecimal, as a shader has it."""
    return "vec3({:.4f}, {:.4f}, {:.4f})".format(*(value / 255 for value in rgb(colour)))


# What the shaders of a label's plate and letters end with, and what is told them then.
LABELS = {
    "gl_FragColor = vec4(1.0, 1.0, 1.0, 0.85 * vAlpha);": f"gl_FragColor.rgb = mix(vec3(1.0), {_glsl(PLATE)}, dark);",
    "gl_FragColor = vec4(0.0, 0.0, 0.0, a);": f"gl_FragColor.rgb = {_glsl(LETTERS)} * dark;",
}

# An element of viser's page, to be read before its program.
SHADERS = f"""<script>
{{
  const FARTHER = "0.008";
  const LABELS = {json.dumps(LABELS)};
  const context = WebGL2RenderingContext.prototype, {{ shaderSource, useProgram }} = context;
  context.shaderSource = function (shader, text) {{
    let told = text;
    if (text.includes("gl_PointSize") && text.includes("projectionMatrix")) {{
      told = text
        .replace("void main", "uniform float smaller;\\nvoid main")
        .replace(/}}\\s*$/, "gl_PointSize *= 1.0 - smaller; }}")
        .replace(/}}$/, `gl_Position.z -= ${{FARTHER}} * projectionMatrix[3][2]; }}`);
    }}
    for (const [theirs, ours] of Object.entries(LABELS)) {{
      if (text.includes(theirs)) {{
        told = text.replace("void main", "uniform float dark;\\nvoid main").replace(theirs, `${{theirs}} ${{ours}}`);
      }}
    }}
    shaderSource.call(this, shader, told);
  }};
  const places = new WeakMap(); // of `dark` in a program; null where it has none
  context.useProgram = function (program) {{
    useProgram.call(this, program);
    if (program === null) return;
    if (!places.has(program)) places.set(program, this.getUniformLocation(program, "dark"));
    const place = places.get(program);
    if (place) this.uniform1f(place, document.documentElement.dataset.mantineColorScheme === "dark" ? 1 : 0);
  }};
}}
</script>"""
