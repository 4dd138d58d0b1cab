function [u, s, flags] = @id@_inverse(y, s, y0, u0)
% @id@_inverse  Voltage (@in@) for [y y' ... y^(@order@)] (@derivative_unit@) at this sample, every @dt@ s.
% The displacement y is @meaning@.
%   [u, s, flags] = @id@_inverse(y)     from rest;  (y, [], y0, u0) from held at y0 under u0
%   [u, s, flags] = @id@_inverse(y, s)  the next sample. Where y is not finite u is the last voltage.
% flags: 1 not a number, 2 no voltage makes the force, 4 cut by @low@ to @high@ @in@, 8 cut by @slew@ @slew_unit@.
% The drive is @ahead@ s late: ask for the target of then. Written by pitp_jax; do not edit, write it again.
if nargin < 2 || isempty(s)
    if nargin < 4, y0 = 0; u0 = 0; end
    s = [start([], [y0; u0]); u0];
end
u = s(end);
flags = 1;
if all(isfinite(y))
    [next, out] = step(s(1:end - 1), y);
    wanted = min(max(out(1), @low@), @high@);
    u = min(max(wanted, u - @slew@ * @dt_number@), u + @slew@ * @dt_number@);
    flags = 2 * (out(2) > 0) + 4 * (wanted ~= out(1)) + 8 * (u ~= wanted);
    s = [next; u];
end
end

@functions@
function r = pick(c, a, b)
if c, r = a; else, r = b; end
end
