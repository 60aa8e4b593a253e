"""One OpenGL context for the tests of shader functions, and the means to call such a function from Python."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
import pytest

from irpso_addon.core.data import Solution
from irpso_addon.core.job import Progress
from irpso_addon.core.shading.tables import principled_table
from irpso_addon.gpu.device import thread
from irpso_addon.gpu.device.context import Device
from irpso_addon.gpu.device.memory import newest_context
from irpso_addon.gpu.device.programs import assemble
from tests.gpu.glsl import Recorder
from tests.support import shoots
from tests.support import synthetic as syn

WIDTH = 64  # of the image whose pixels are the calls
Evaluate = Callable[..., np.ndarray]
OnGL = Callable[[Callable[[Device], Any]], Any]


left_out: list[pytest.Item] = []  # by -k, -m or --deselect


def pytest_deselected(items: list[pytest.Item]) -> None:
    """A run without these may leave shaders out."""
    left_out.extend(items)


@pytest.fixture(scope="session", autouse=True)
def recorder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Recorder]:
    """Every program compiled in this process; at its end, whatever the order of the tests, what is wrong with them.

    That is an error at the teardown of the test that happened to be the last.
    """
    made = Recorder()
    with pytest.MonkeyPatch.context() as patch:
        made.patch(patch)
        yield made
        wrong = made.faults(tmp_path_factory.mktemp("glslang"))
        if whole(request.session):
            version = thread.run(version_code)
            wrong += [f"no test used {name}" for name in made.unused(version)]
    if wrong:
        pytest.fail("programs of this run:\n" + "\n".join(wrong), pytrace=False)


def whole(session: pytest.Session) -> bool:
    """Whether all of this folder ran: else shaders are missing for that reason."""
    files = {path.name for path in Path(__file__).parent.glob("test_*.py")}
    stopped = session.shouldstop or session.shouldfail or left_out
    return not stopped and {item.path.name for item in session.items} >= files


def version_code() -> Iterator[Progress]:
    """Of the device that the tests used: 410 is OpenGL 4.1."""
    yield Progress(0.0, "test")
    return thread.device().ctx.version_code


@pytest.fixture(scope="session")
def ctx() -> Iterator[moderngl.Context]:
    context = newest_context()
    yield context
    context.release()


@pytest.fixture
def evaluate(ctx: moderngl.Context) -> Evaluate:
    """evaluate("include/brdf.glsl", "o = vec4(D_ggx(a.x, a.y));", arguments) -> (n, 4) float32.

    One call of the body per row of ``arguments`` (n, up to 8), which it sees as vec4 a and b; it writes vec4 o.
    """

    idle = ctx.simple_framebuffer((1, 1))

    def call(include: str, body: str, arguments: np.ndarray, uniforms: Mapping[str, Any] | None = None,
             defines: Mapping[str, str] | None = None) -> np.ndarray:
        rows = -(-len(arguments) // WIDTH)
        padded = np.zeros((rows * WIDTH, 8), np.float32)
        padded[: len(arguments), : arguments.shape[1]] = arguments
        source = assemble(include, defines) + f"""
            uniform sampler2D u_a;
            uniform sampler2D u_b;
            out vec4 o;
            void main() {{
                vec4 a = texelFetch(u_a, ivec2(gl_FragCoord.xy), 0), b = texelFetch(u_b, ivec2(gl_FragCoord.xy), 0);
                {body}
            }}"""
        program = ctx.program(
            vertex_shader="#version 330 core\nvoid main() { gl_Position = vec4(gl_VertexID == 1 ? 3 : -1, "
                          "gl_VertexID == 2 ? 3 : -1, 0, 1); }",
            fragment_shader=source)
        table = principled_table()
        textures = {
            "u_a": ctx.texture((WIDTH, rows), 4, padded[:, :4].tobytes(), dtype="f4"),
            "u_b": ctx.texture((WIDTH, rows), 4, padded[:, 4:].tobytes(), dtype="f4"),
            "u_principled_table": ctx.texture(table.shape[1::-1], 4, table.tobytes(), dtype="f4"),
        }
        for unit, (name, texture) in enumerate(textures.items()):
            texture.use(unit)
            if name in program:
                program[name].value = unit
        for name, value in (uniforms or {}).items():
            if name in program:  # the compiler drops what a body does not need
                program[name].value = value
        target = ctx.texture((WIDTH, rows), 4, dtype="f4")
        frame = ctx.framebuffer([target])
        frame.use()
        vertices = ctx.vertex_array(program, [])
        vertices.render(moderngl.TRIANGLES, vertices=3)
        result = np.frombuffer(target.read(), np.float32).reshape(-1, 4)[: len(arguments)]
        idle.use()  # a deleted framebuffer must not stay bound
        for made in (vertices, frame, target, program, *textures.values()):
            made.release()
        assert ctx.error == "GL_NO_ERROR"
        return result

    return call


@pytest.fixture(scope="session")
def on_gl() -> OnGL:
    """on_gl(function) -> function(device), called on the GL thread."""

    def call(function: Callable[[Device], Any]) -> Any:
        def job() -> Iterator[Progress]:
            yield Progress(0.0, "test")
            return function(thread.device())

        return thread.run(job)

    return call


@pytest.fixture(scope="session")
def patches() -> syn.Shoot:
    """Four materials on a plane, two cameras with eight lamps each, without noise."""
    return syn.shoot(syn.PATCHES, shoots.rig())


@pytest.fixture(scope="session")
def solved(patches: syn.Shoot) -> dict[str, Solution]:
    """Their solutions by each method."""
    return {method: shoots.run(patches, method=method) for method in shoots.METHODS}
