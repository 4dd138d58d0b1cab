function [y, s] = @id@_predict(u, s, y0, u0)
% @id@_predict  Displacement (@out@) at the sample of a voltage (@in@), every @dt@ s.
% The displacement is @meaning@.
%   [y, s] = @id@_predict(u)     from rest;  (u, [], y0, u0) from held at y0 under u0
%   [y, s] = @id@_predict(u, s)  the next sample. Where u is not finite y is NaN and s stays.
% Written by pitp_jax; do not edit, write it again.
if nargin < 2 || isempty(s)
    if nargin < 4, y0 = 0; u0 = 0; end
    s = start([], [y0; u0]);
end
y = NaN;
if isfinite(u)
    [s, y] = step(s, u);
end
end

@functions@
function r = pick(c, a, b)
if c, r = a; else, r = b; end
end
