function @id@_check
% @id@_check  @count@ samples of @what@, both ways, against the program that wrote this; an error where they differ.
voltage = [@voltage@];
displacement = [@displacement@];
target = [@targets@];
planned = [@planned@];
s = [];
y = zeros(size(voltage));
for k = 1:numel(voltage)
    for part = (1:@every@) / @every@  % of the way from the number before
        [y(k), s] = @id@_predict(voltage(max(k - 1, 1)) * (1 - part) + voltage(k) * part, s);
    end
end
s = [];
u = zeros(size(planned));
for k = 1:numel(planned)
    for part = (1:@every@) / @every@
        [u(k), s] = @id@_inverse(target(max(k - 1, 1), :)' * (1 - part) + target(k, :)' * part, s);
    end
end
worst = max(abs(y - displacement)) / @range@;
wrong = max(abs(@force_error@)) / @force_range@;
fprintf('predict: %.2g of the stroke, inverse: %.2g of the force\n', worst, wrong);
assert(worst < @tolerance@ && wrong < @force_tolerance@, 'they differ');
end
