function @id@_check
% @id@_check  @count@ samples of @what@, both ways, against the program that wrote this; an error where they differ.
voltage = [@voltage@];
displacement = [@displacement@];
target = [@targets@];
planned = [@planned@];
s = [];
y = zeros(size(voltage));
for k = 1:numel(voltage)
    [y(k), s] = @id@_predict(voltage(k), s);
end
s = [];
u = zeros(size(planned));
for k = 1:numel(planned)
    [u(k), s] = @id@_inverse(target(k, :)', s);
end
worst = max(abs(y - displacement)) / @range@;
wrong = max(abs(@force_error@)) / @force_range@;
fprintf('predict: %.2g of the range, inverse: %.2g of the force\n', worst, wrong);
assert(worst < @tolerance@ && wrong < @force_tolerance@, 'they differ');
end
