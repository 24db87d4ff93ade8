"""Levenberg-Marquardt for bundle adjustment: many small blocks, connected by a few views.

A sighting depends only on one view (a camera) and one block (a person). The blocks are therefore
eliminated one by one (Schur complement), and one forward-mode derivative per parameter of a view
and of a block gives the whole Jacobian.

A problem is a function of `Unknowns` and `Args` that returns `robust` of its `Residuals`. It is
solved by `minimize` or, if it is small, by `optx.least_squares(problem, ..., has_aux=True)` with
any other solver of optimistix.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int, PyTree

SMALLEST_DAMPING, LARGEST_DAMPING = 1e-8, 1e6  # relative increase of the diagonal
RISE = 10.0  # factor of the damping after rejected steps
# Widths of robust losses in standard deviations: 95 % efficient for normal errors; and where the
# weight is 1/2.
HUBER, CAUCHY = 1.345, 2.0

Loss = Callable[[Float[Array, "*n"]], Float[Array, "*n"]]
# (q,) parameters on which sightings depend and which are fixed but uncertain, and data.
Args = tuple[Float[Array, " q"], Any]


class Unknowns(NamedTuple):
    """The unknowns of a problem.

    Attributes:
        view: (V, v) parameters of each view.
        block: (B, b) parameters of each block; b may be 0.
    """

    view: Float[Array, "view v"]
    block: Float[Array, "block b"]


class Residuals(NamedTuple):
    """The standardized residuals of a problem.

    Attributes:
        sighting: (V, B, e, d) e vectors of length d per view and block; zero where the view does
            not see the block. Each depends only on its view and its block.
        view: (m,) priors on the views; each may depend on all views.
        block: (B, n) priors on the blocks; each depends only on its block.
    """

    sighting: Float[Array, "view block e d"]
    view: Float[Array, " m"]
    block: Float[Array, "block n"]


Problem = Callable[[Unknowns, Args], tuple[Residuals, Residuals]]


def cauchy(squared: Float[Array, "*n"], width: float) -> Float[Array, "*n"]:
    """Apply the Cauchy loss to squared residuals; a residual of `width` has weight 1/2."""
    return width**2 * jnp.log1p(squared / width**2)


def huber(squared: Float[Array, "*n"], width: float) -> Float[Array, "*n"]:
    """Apply the Huber loss to squared residuals: quadratic up to `width`, then linear."""
    inside = squared <= width**2
    length = jnp.sqrt(jnp.where(inside, width**2, squared))
    return jnp.where(inside, squared, 2 * width * length - width**2)


def robust(residuals: Residuals, loss: Loss) -> tuple[Residuals, Residuals]:
    """Apply a robust loss to the lengths of the sightings; priors remain quadratic.

    Args:
        residuals: residuals of the problem.
        loss: cost of squared lengths, with slope 1 at zero and a falling slope.

    Returns:
        Residuals whose sum of squares is the robust cost; and the given residuals times the square
        root of their weight (the slope of the loss, constant in derivatives). The latter have the
        gradient of the robust cost, and the usual approximation of its curvature.
    """
    squared = jnp.sum(residuals.sighting**2, axis=-1, keepdims=True)
    cost, weight = jax.jvp(loss, (squared,), (jnp.ones_like(squared),))
    positive = squared > 0
    stretch = jnp.sqrt(jnp.where(positive, cost / jnp.where(positive, squared, 1), 1))
    root = jnp.sqrt(jax.lax.stop_gradient(weight))
    return (
        residuals._replace(sighting=residuals.sighting * stretch),
        residuals._replace(sighting=residuals.sighting * root),
    )


class NormalEquations(NamedTuple):
    """The normal equations of a linearized problem, blocks last for long contiguous rows.

    The common parameters are those of all views (V v), then the uncertain ones (q).

    Attributes:
        common: (c, c) matrix of the common parameters.
        mixed: (b, c, B) between blocks and common parameters.
        block: (b, b, B) matrix of each block.
        common_right: (c,) negative half gradient.
        block_right: (b, 1, B) negative half gradient.
    """

    common: Float[Array, "c c"]
    mixed: Float[Array, "b c block"]
    block: Float[Array, "b b block"]
    common_right: Float[Array, " c"]
    block_right: Float[Array, "b 1 block"]

    @classmethod
    def of(
        cls, problem: Problem, at: Unknowns, args: Args
    ) -> tuple["NormalEquations", tuple[Residuals, Residuals]]:
        """Linearize a problem; also return its values."""
        (views, v), (blocks, b), (uncertain, data) = at.view.shape, at.block.shape, args
        size = views * v

        def shifted(shift: Float[Array, " step"]) -> tuple[Any, Any]:
            moved = Unknowns(at.view + shift[None, :v], at.block + shift[None, v : v + b])
            out, aux = problem(moved, (uncertain + shift[v + b :], data))
            return (aux.sighting, aux.block), (out, aux)

        shift = jnp.zeros(v + b + len(uncertain), at.view.dtype)
        (slope, block_prior), (out, aux) = jax.jacfwd(shifted, has_aux=True)(shift)
        prior = jax.jacfwd(lambda view: problem(at._replace(view=view), args)[1].view)(at.view)
        prior = prior.reshape(-1, size)
        block_prior = block_prior[..., v : v + b].transpose(1, 2, 0)
        slope = slope.reshape(views, blocks, -1, len(shift)).transpose(0, 2, 3, 1)
        r = aux.sighting.reshape(views, blocks, 1, -1).transpose(0, 3, 2, 1)
        by_common = jnp.concatenate([slope[:, :, :v], slope[:, :, v + b :]], 2)
        by_block = slope[:, :, v : v + b]

        def joined(of_views: Array, of_uncertain: Array, axis: int = 0) -> Array:
            shape = *of_views.shape[1 : axis + 1], size, *of_views.shape[axis + 2 :]
            of_views = jnp.moveaxis(of_views, 0, axis).reshape(shape)
            return jnp.concatenate([of_views, of_uncertain.sum(0)], axis)

        normal = jnp.einsum("kcvp,kcwp->kvw", by_common, by_common)
        mixed = (by_common[:, :, None] * by_block[:, :, :, None]).sum(1)
        right = jnp.einsum("kcvp,kcup->kv", by_common, r)
        axis = jnp.arange(views)
        diagonal = (
            jnp.zeros((views, v, views, v), normal.dtype).at[axis, :, axis].set(normal[:, :v, :v])
        )
        cross = normal[:, :v, v:].reshape(size, -1)
        common = jnp.block(
            [
                [diagonal.reshape(size, size) + prior.T @ prior, cross],
                [cross.T, normal[:, v:, v:].sum(0)],
            ]
        )
        equations = cls(
            common,
            joined(mixed[:, :, :v], mixed[:, :, v:], 1),
            (by_block[:, :, :, None] * by_block[:, :, None]).sum((0, 1))
            + (block_prior[:, :, None] * block_prior[:, None]).sum(0),
            -joined(right[:, :v], right[:, v:]).at[:size].add(prior.T @ aux.view),
            -(by_block * r).sum((0, 1))[:, None]
            - (block_prior * aux.block.T[:, None]).sum(0)[:, None],
        )
        return equations, (out, aux)

    def damped(self, damping: Float[Array, ""] | float) -> "NormalEquations":
        """Scale up the diagonals; parameters that no residual contains stay in place."""

        def raised(diagonal: Array) -> Array:
            return jnp.where(diagonal == 0, 1, damping * diagonal)

        i, j = jnp.arange(len(self.common)), jnp.arange(len(self.block))
        return self._replace(
            common=self.common.at[i, i].add(raised(self.common[i, i])),
            block=self.block.at[j, j].add(raised(self.block[j, j])),
        )

    def eliminated(
        self,
    ) -> tuple[Float[Array, "c c"], Float[Array, " c"], Float[Array, "b column block"]]:
        """Eliminate the blocks.

        Returns:
            Matrix and right-hand side of the common parameters; and, for each block, the solutions
            of its own system with `mixed` and `block_right` on the right.
        """
        solved = _solve_blocks(self.block, jnp.concatenate([self.mixed, self.block_right], 1))
        c = len(self.common)
        mixed = self.mixed.transpose(1, 0, 2).reshape(c, -1)
        product = mixed @ solved.transpose(1, 0, 2).reshape(c + 1, -1).T
        return self.common - product[:, :c], self.common_right - product[:, c], solved

    def solve(self, free: int) -> tuple[Float[Array, " free"], Float[Array, "block b"]]:
        """Solve for the first `free` common parameters and the blocks, holding the others."""
        reduced, right, solved = self.eliminated()
        operator = lx.MatrixLinearOperator(reduced[:free, :free], lx.positive_semidefinite_tag)
        common = lx.linear_solve(operator, right[:free], lx.Cholesky(), throw=False).value
        return common, (solved[:, -1] - jnp.einsum("bcp,c->bp", solved[:, :free], common)).T

    def covariance(self, uncertain: Float[Array, "q q"]) -> Float[Array, "c c"]:
        """Compute the covariance of the common parameters at a solution.

        Args:
            uncertain: (q, q) covariance of the fixed but uncertain parameters, whose effect on the
                solution is included ("consider covariance").

        Returns:
            (c, c) covariance; a parameter of a view that no residual contains has variance 1.
        """
        reduced, _, _ = self.damped(SMALLEST_DAMPING).eliminated()
        free = len(reduced) - len(uncertain)
        matrix = reduced[:free, :free]
        scale = jnp.sqrt(jnp.abs(jnp.diagonal(matrix)))
        unit = jnp.outer(scale, scale)
        inverse = jnp.linalg.pinv(matrix / unit, hermitian=True) / unit
        eye = jnp.eye(len(uncertain), dtype=unit.dtype)
        slope = jnp.concatenate([-inverse @ reduced[:free, free:], eye])
        return jnp.pad(inverse, (0, len(uncertain))) + slope @ uncertain @ slope.T


def _solve_blocks(
    matrix: Float[Array, "b b block"], right: Float[Array, "b column block"]
) -> Float[Array, "b column block"]:
    """Solve a small positive definite system per block by elimination, elementwise over blocks."""
    rows = jnp.concatenate([matrix, right], 1)
    for i in range(len(matrix)):
        pivot = rows[i] / rows[None, i, i]
        rows = (rows - rows[:, i, None] * pivot[None]).at[i].set(pivot)
    return rows[:, len(matrix) :]


class _State(NamedTuple):
    proposed: Unknowns
    equations: NormalEquations
    cost: Float[Array, ""]
    damping: Float[Array, ""]
    steps: Int[Array, ""]
    terminate: Bool[Array, ""]


class SchurLevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """Levenberg-Marquardt that eliminates the blocks; see the module for the form of problems.

    Each step solves the normal equations with relatively increased diagonals. If the (robust) cost
    does not fall or is not finite, the step is rejected and the diagonals are increased further.
    The statistics of the solution hold its `cost` and its `NormalEquations`.

    Attributes:
        rtol: relative decrease of the cost at which the iteration ends.
        atol: absolute decrease at which it ends.
        damping: damping of the first step.
        fall: factor by which accepted steps lower it.
        most_steps: maximum number of steps; changing it causes no recompilation.
        norm: unused; part of the interface.

    Source:
        Triggs et al. (2000), "Bundle adjustment: a modern synthesis", sections 4 and 6.
    """

    rtol: float = 1e-4
    atol: float = 0.0
    damping: float = 1e-3
    fall: float = 5.0
    most_steps: Int[Array, ""] | int = 256
    norm: Callable[[PyTree], Array] = optx.max_norm

    def init(self, fn, y, args, options, f_struct, aux_struct, tags) -> _State:
        """Propose the start itself."""
        dtype, (views, v), (blocks, b) = y.view.dtype, y.view.shape, y.block.shape
        c = views * v + len(args[0])
        shapes = (c, c), (b, c, blocks), (b, b, blocks), (c,), (b, 1, blocks)
        equations = NormalEquations(*(jnp.zeros(shape, dtype) for shape in shapes))
        cost, damping = jnp.asarray(jnp.inf, dtype), jnp.asarray(self.damping * self.fall, dtype)
        return _State(y, equations, cost, damping, jnp.zeros((), jnp.int32), jnp.asarray(False))

    def step(self, fn, y, args, options, state, tags) -> tuple[Unknowns, _State, Any]:
        """Accept or reject the proposed unknowns, and propose others."""
        equations, (out, aux) = NormalEquations.of(fn, state.proposed, args)
        cost = sum((jnp.sum(leaf**2) for leaf in out), jnp.zeros_like(state.cost))
        better = cost < state.cost
        y, equations, lowest = jax.tree.map(
            lambda new, old: jnp.where(better, new, old),
            (state.proposed, equations, cost),
            (y, state.equations, state.cost),
        )
        lower = jnp.maximum(state.damping / self.fall, SMALLEST_DAMPING)
        damping = jnp.where(better, lower, state.damping * RISE)
        view, block = equations.damped(damping).solve(y.view.size)
        proposed = Unknowns(y.view + view.reshape(y.view.shape), y.block + block)
        converged = better & (state.cost - cost < self.rtol * state.cost + self.atol)
        ended = converged | (damping > LARGEST_DAMPING) | (state.steps >= self.most_steps)
        return y, _State(proposed, equations, lowest, damping, state.steps + 1, ended), aux

    def terminate(self, fn, y, args, options, state, tags) -> tuple[Bool[Array, ""], optx.RESULTS]:
        """Return whether the iteration ended; it always ends successfully."""
        return state.terminate, optx.RESULTS.successful

    def postprocess(
        self, fn, y, aux, args, options, state, tags, result
    ) -> tuple[Unknowns, Any, dict[str, Any]]:
        """Add the cost and the normal equations of the solution to the statistics."""
        return y, aux, {"cost": state.cost, "equations": state.equations}


def minimize(
    problem: Problem, start: Unknowns, args: Args, solver: SchurLevenbergMarquardt
) -> optx.Solution:
    """Solve a problem, or take the solver's maximum number of steps."""
    return optx.least_squares(
        problem, solver, start, args, has_aux=True, max_steps=None, throw=False
    )
